"""Build the tables, and write them as Markdown, CSV, LaTeX and for the terminal."""
