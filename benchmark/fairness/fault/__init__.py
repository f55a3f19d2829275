"""Whose fault a contact is, from who entered whose path, with how much time left, and who had priority.

`benchmark.fairness.fault.rules.attribute_fault` is the whole of it: tracks, roads and handedness in, verdict out.
"""
