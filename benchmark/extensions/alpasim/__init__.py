"""AlpaSim's egodriver contract, both ways: policies behind gRPC are judged here, and our planners are served to it.

Messages are made from one table (`messages`); what they mean is in ``docs/extensions/alpasim.md``.
"""
