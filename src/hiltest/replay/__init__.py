"""Record and replay: everything that a run asks of its bench, with the answers, kept in a file and given again."""
