"""The shipped scenarios, one YAML each."""
