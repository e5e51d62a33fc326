"""Build the HTML page: sections, legends and embedded images."""
