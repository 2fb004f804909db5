"""What a result looks like: flux maps over the current disc, diagnostics, captions."""
