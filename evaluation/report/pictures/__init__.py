"""Draw images from stored arrays: rendered views, plans from above, the Plane Scene Graph."""
