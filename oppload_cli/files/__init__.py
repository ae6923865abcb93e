"""Files: results that appear complete or not at all, tables, pages, and what is read back."""
