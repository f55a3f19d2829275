"""`verify model --model magicdrive`: the network, its guidance and its sampler against numbers of the official code."""
