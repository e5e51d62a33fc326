"""Measure speeds for ``asg bench``, with one module per benchmark."""
