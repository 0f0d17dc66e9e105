"""Plain versions of what the package does fast: as the specification reads, for the tests to compare with."""
