"""Record and replay: all questions of a run to its bench, with the answers, in a file that can replace the bench."""
