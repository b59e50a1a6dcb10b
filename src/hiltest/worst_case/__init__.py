"""The most cycles of a function: a search over its inputs, and the inputs that were found, kept to be replayed."""
