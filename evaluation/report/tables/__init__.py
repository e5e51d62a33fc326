"""Build the tables of reports, and write them as Markdown, CSV and LaTeX and for the terminal."""
