"""Messages: definitions, types, fields, and blocks of samples to and from CDR."""
