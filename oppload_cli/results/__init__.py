"""Results: the per-frame table, its sidecar, and reading them back."""
