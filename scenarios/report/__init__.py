"""`appli report`: tables, figures and one page from stored trials."""
