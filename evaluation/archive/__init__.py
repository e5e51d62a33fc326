"""Run directories: jobs, what a run keeps, and reading it again."""
