"""From image features to a bird's-eye view, and from the view to agents and map elements."""

from torch import Tensor, nn

from adapters.networks.layers.bev_network import BEVTransformer, bev_decoder, can_bus_network
from adapters.networks.layers.deformable_decoder import Decoded
from adapters.networks.vad.config import VADConfig

LEVEL_EMBEDDINGS = 4
"""Published networks have as many whether or not they use them."""


class VADTransformer(BEVTransformer):
    """The encoder and the two decoders of VAD (section 3.1 of its paper)."""

    def __init__(self, config: VADConfig) -> None:
        super().__init__(config, max(LEVEL_EMBEDDINGS, config.pyramid_levels))
        self.decoder = bev_decoder(config)
        self.map_decoder = bev_decoder(config)
        self.reference_points = nn.Linear(config.channels, 3)
        self.map_reference_points = nn.Linear(config.channels, 2)
        self.can_bus_mlp = can_bus_network(config.channels)

    def decode_agents(self, queries: Tensor, bev: Tensor, branches: nn.ModuleList) -> Decoded:
        """Agents in a bird's-eye view of (cells, C): their states and x, y, z.

        `queries` are (A, 2 C), positions and then contents; `branches` take (A, C) to (A, 10) corrections, one for
        each layer.
        """
        positions, contents = queries.chunk(2, -1)
        references = self.reference_points(positions).float().sigmoid()
        shapes = (self.encoder.grid.shape,)
        decoded: Decoded = self.decoder(contents, positions, references, bev, shapes, branches, (0, 1, 4))
        return decoded

    def decode_map(self, queries: Tensor, bev: Tensor, branches: nn.ModuleList) -> Decoded:
        """Points of map elements in a bird's-eye view; arguments as in `decode_agents`, corrections (M * P, 2)."""
        positions, contents = queries.chunk(2, -1)
        references = self.map_reference_points(positions).float().sigmoid()
        shapes = (self.encoder.grid.shape,)
        decoded: Decoded = self.map_decoder(contents, positions, references, bev, shapes, branches, (0, 1))
        return decoded
