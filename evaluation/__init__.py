"""Who compares: protocols, metrics, the grid of jobs, the run directory, the report and the command line.

`comparison.Comparison` describes scenes x policies x seeds, `jobs.Job` one episode of it, `episode.run_job` runs one,
`engines` run many, `store` reads what they wrote, `report` draws it. Nothing imports this room.

Nothing is imported here, so that ``asg --help`` answers at once.
"""
