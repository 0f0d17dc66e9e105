"""World -> MJCF arena."""
