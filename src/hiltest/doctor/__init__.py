"""What can be wrong with a bench, looked at one by one before anything is measured; each with its remedy."""
