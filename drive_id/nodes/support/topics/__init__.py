"""Topics that a node subscribes to: of a drive, of strangers, and of any type; their types and subscriptions."""
