"""Results for people: tables, pictures, the paper's tables reproduced."""
