"""The report: one page, tables, convergence curves, pictures; all made from run directories.

`results.Results` is what a report is about, `summary.write_results` writes all of it, `page.html_page` is the page.
"""
