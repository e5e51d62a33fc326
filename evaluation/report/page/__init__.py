"""Build the HTML page of the report: sections, legends and embedded images."""
