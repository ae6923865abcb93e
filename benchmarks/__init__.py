"""Programs that measure speed, cost and the figures of the pages; see README.md."""
