"""One pytest session with hiltest in it: options, chosen tests, their findings, and the bench."""
