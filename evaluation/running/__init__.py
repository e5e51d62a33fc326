"""Running jobs: one episode, its worker, the engines, a whole comparison."""
