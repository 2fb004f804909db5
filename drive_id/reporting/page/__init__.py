"""The report of a result: one HTML file, and a PDF of the same content."""
