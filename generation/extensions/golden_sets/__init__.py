"""Physics, scoring and denoiser compared with golden numbers, for users as much as for tests.

A broken linear algebra library or a silent zero in an accelerator shows here before it shows in results.
"""
