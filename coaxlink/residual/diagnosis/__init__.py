"""Tracing by evidence: log -> channels -> hypotheses -> evidence -> answer.

Every explanation (an effect, a free form, a correction of the nuisance, the smooth part of the rotor map) is
a part of one linear-Gaussian model once its few shape numbers are fixed. A set of explanations is judged by
its marginal likelihood, and the answer is read off the posterior over sets.
"""
