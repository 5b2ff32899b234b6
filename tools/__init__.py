"""Scripts for those who develop fiberloom: figures of the tree, coverage, mutants. Not shipped."""
