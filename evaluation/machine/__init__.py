"""Inspect and control this machine: threads, processes, hardware and the terminal."""
