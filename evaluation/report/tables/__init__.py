"""Tables as data, and their texts: Markdown, CSV, LaTeX and the terminal."""
