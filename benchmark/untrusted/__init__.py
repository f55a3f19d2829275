"""Readers of untrusted files: all third-party data is opened here, with declared limits (`files.py`).

What can be bounded by looking is looked at before it is read. What cannot, unpickling above all, is taken apart by a
child process that may use only so much memory and time, and that answers with plain values and arrays.
"""
