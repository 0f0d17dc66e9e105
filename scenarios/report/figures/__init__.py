"""Pictures of the report: the only files that draw with matplotlib."""
