"""Doing finished work again: a run is played again and compared, or its map is measured again."""
