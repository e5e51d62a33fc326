"""Reproduce finished runs: play a run again and compare it, or measure its map again."""
