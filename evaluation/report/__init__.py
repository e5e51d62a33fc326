"""Write the report from run directories: one page, tables, convergence curves, images.

`results.Results` holds the data of a report, `page.document.html_page` builds the page, and `summary.write_results`
writes all files.
"""
