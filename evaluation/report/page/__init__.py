"""The HTML page: its sections, legends and embedded pictures."""
