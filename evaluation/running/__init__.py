"""From a job to its directory: one episode, its worker, the engines, a whole comparison."""
