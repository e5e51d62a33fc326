"""Define jobs, write run directories, and read them back."""
