"""The report: one page, tables, convergence curves, pictures; all made from run directories.

`results.Results` holds the data of a report, `page.document.html_page` builds the page, and `summary.write_results`
writes all files.
"""
