"""Files: writing them completely or not at all, tables, HTML pages, and reading."""
