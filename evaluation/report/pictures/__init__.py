"""Draw images from the stored arrays of runs: rendered views, plans from above, the Plane Scene Graph."""
