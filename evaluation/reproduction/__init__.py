"""Reproduce finished runs: play a run again and compare the files, or measure its stored map again."""
