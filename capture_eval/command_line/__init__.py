"""The `capture-eval` command: flags only."""
