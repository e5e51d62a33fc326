"""What a reader sees: tables, convergence curves, pictures, the summary page; all rebuilt from run directories.

`summary.write_report` writes everything into a comparison's directory.
"""
