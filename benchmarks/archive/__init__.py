"""Archives: drawn star lists, bookkeeping, kills."""
