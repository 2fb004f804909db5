"""What the nodes share: parameters, subscriptions, services, diagnostics, conversion to messages."""
