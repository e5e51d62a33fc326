"""Run jobs: a single episode, its worker process, the engines, and a whole comparison."""
