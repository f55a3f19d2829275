"""What an agent's forecasts look at: each other, other agents, the map and their goals."""

from torch import Tensor, nn

from adapters.networks.layers.attention import FeedForward
from adapters.networks.layers.sampling import deformable_sampling
from adapters.networks.uniad.config import UniADConfig


def embedding_layer(channels: int) -> nn.Sequential:
    """Two linear layers, the first twice as wide."""
    return fusion_layer(channels, channels)


def fusion_layer(inputs: int, channels: int) -> nn.Sequential:
    """Layers from `inputs` numbers to `channels`, over twice as many."""
    return nn.Sequential(nn.Linear(inputs, 2 * channels), nn.ReLU(), nn.Linear(2 * channels, channels))


class AgentInteraction(nn.Module):
    """The modes of an agent look at each other and then at other things."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.interaction_transformer = nn.TransformerDecoderLayer(channels, heads, hidden, batch_first=True)

    def forward(self, tokens: Tensor, things: Tensor) -> Tensor:
        """(A, modes, C) and (T, C) to (A, modes, C)."""
        result: Tensor = self.interaction_transformer(tokens, things.expand(len(tokens), *things.shape))
        return result


class IntentionInteraction(nn.Module):
    """The modes of an agent look at each other."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.interaction_transformer = nn.TransformerEncoderLayer(channels, heads, hidden, batch_first=True)

    def forward(self, tokens: Tensor) -> Tensor:
        """(A, modes, C) to (A, modes, C)."""
        result: Tensor = self.interaction_transformer(tokens)
        return result


class GoalAttention(nn.Module):
    """Deformable attention around the end of a forecast, with a pattern for each of its steps."""

    def __init__(self, channels: int, heads: int, steps: int, points: int) -> None:
        super().__init__()
        self.heads, self.steps, self.points = heads, steps, points
        self.sampling_offsets = nn.Linear(channels, heads * steps * points * 2)
        self.attention_weights = nn.Linear(channels, heads * steps * points)
        self.value_proj = nn.Linear(channels, channels)
        self.output_proj = nn.Sequential(nn.Linear(steps * channels, channels), nn.LayerNorm(channels), nn.ReLU())

    def forward(self, tokens: Tensor, positions: Tensor, goals: Tensor, bev: Tensor, shape: tuple[int, int]) -> Tensor:
        """Tokens, (Q, C), that have looked at (cells, C) around goals: (Q, 2) x, y, 0 to 1 over the bird's-eye view."""
        query, looks = tokens + positions, (len(tokens), self.heads, self.steps, 1, self.points)
        offsets = self.sampling_offsets(query).view(*looks, 2)
        weights = self.attention_weights(query).view(looks).float().softmax(-1)
        values = self.value_proj(bev).view(1, len(bev), self.heads, -1)
        places = goals.repeat_interleave(self.steps, 0)
        sampled = deformable_sampling(
            values,
            (shape,),
            places[:, None, None, None],
            offsets.transpose(1, 2).flatten(0, 1),
            weights.transpose(1, 2).flatten(0, 1),
        )
        attended: Tensor = self.output_proj(sampled.view(len(tokens), -1))
        return tokens + attended


class GoalInteraction(nn.Module):
    """`GoalAttention`, then a feed-forward block; each is normalised after its addition."""

    def __init__(self, channels: int, heads: int, hidden: int, steps: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([GoalAttention(channels, heads, steps, points)])
        self.ffns = nn.ModuleList([FeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(2)])

    def forward(self, tokens: Tensor, positions: Tensor, goals: Tensor, bev: Tensor, shape: tuple[int, int]) -> Tensor:
        """Arguments and result as in `GoalAttention`."""
        tokens = self.norms[0](self.attentions[0](tokens, positions, goals, bev, shape))
        result: Tensor = self.norms[1](self.ffns[0](tokens))
        return result


class MotionFormer(nn.Module):
    """The interactions of all layers, and what fuses them."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        channels, layers = config.channels, range(config.motion_layers)
        sizes = (channels, config.heads, config.feedforward_channels)
        self.intention_interaction_layers = IntentionInteraction(*sizes)
        self.track_agent_interaction_layers = nn.ModuleList([AgentInteraction(*sizes) for _ in layers])
        self.map_interaction_layers = nn.ModuleList([AgentInteraction(*sizes) for _ in layers])
        self.bev_interaction_layers = nn.ModuleList(
            [GoalInteraction(*sizes, config.forecast_steps, config.bev_points) for _ in layers]
        )
        self.static_dynamic_fuser = fusion_layer(2 * channels, channels)
        self.dynamic_embed_fuser = fusion_layer(3 * channels, channels)
        self.in_query_fuser = fusion_layer(2 * channels, channels)
        self.out_query_fuser = fusion_layer(4 * channels, channels)
