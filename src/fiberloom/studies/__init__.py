"""Experiments on the twin that take many units, or years: what benchmarks, campaigns and the paper ask."""
