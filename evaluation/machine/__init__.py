"""This machine: threads, processes, hardware."""
