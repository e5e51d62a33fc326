"""Write the report on finished runs: one HTML page, tables, convergence curves and images.

`results.Results` holds the data of a report, `page.document.html_page` builds the page, and `summary.write_results`
writes all files.
"""
