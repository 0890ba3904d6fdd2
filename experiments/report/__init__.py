"""The report of a face model's results: one page of HTML, and the same as Markdown."""
