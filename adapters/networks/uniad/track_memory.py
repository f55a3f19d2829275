"""Memory of tracks, and the update of their queries from one key frame to the next."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import nn

from adapters.networks.layers.attention import MultiheadAttention
from adapters.networks.uniad.tracking import Instances

SAVE_EVERY = 3
"""Key frames between two states that a track remembers."""


class MemoryBank(nn.Module):
    """Every instance attends to its own remembered states, then its state is remembered at times."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.save_proj = nn.Linear(channels, channels)
        self.temporal_attn = MultiheadAttention(channels, heads)
        self.temporal_fc1 = nn.Linear(channels, channels)
        self.temporal_fc2 = nn.Linear(channels, channels)
        self.temporal_norm1 = nn.LayerNorm(channels)
        self.temporal_norm2 = nn.LayerNorm(channels)

    def forward(self, instances: Instances) -> Instances:
        """The instances with new states and memories."""
        states, empty = instances.states, instances.memory_empty
        remembers = ~empty[:, -1:]
        # Tracks without memory attend to everything, so that no row is empty; their result is dropped.
        allowed = ~empty[:, None] | ~remembers[:, :, None]
        attended = self.temporal_attn(states[:, None], instances.memory, instances.memory, allowed)[:, 0]
        mixed = self.temporal_norm1(states + attended)
        mixed = self.temporal_norm2(mixed + self.temporal_fc2(F.relu(self.temporal_fc1(mixed))))
        states = torch.where(remembers, mixed, states)

        due, waits = (instances.frames_to_save == 0) & (instances.scores > 0), instances.frames_to_save
        waits = torch.where(due, SAVE_EVERY, waits - (waits > 0).to(waits.dtype))
        newest = self.save_proj(states)[:, None].to(instances.memory.dtype)
        memory = torch.cat([instances.memory[:, 1:], newest], 1)
        shifted = torch.cat([empty[:, 1:], torch.zeros_like(empty[:, :1])], 1)
        return replace(
            instances,
            states=states,
            frames_to_save=waits,
            memory=torch.where(due[:, None, None], memory, instances.memory),
            memory_empty=torch.where(due[:, None], shifted, empty),
        )


class QueryInteraction(nn.Module):
    """Tracks look at each other, and their queries for the next key frame follow."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.self_attn = MultiheadAttention(channels, heads)
        self.linear1 = nn.Linear(channels, channels)
        self.linear2 = nn.Linear(channels, channels)
        self.linear_pos1 = nn.Linear(channels, channels)
        self.linear_pos2 = nn.Linear(channels, channels)
        self.norm_pos = nn.LayerNorm(channels)
        self.linear_feat1 = nn.Linear(channels, channels)
        self.linear_feat2 = nn.Linear(channels, channels)
        self.norm_feat = nn.LayerNorm(channels)
        self.norm1 = nn.LayerNorm(channels)
        self.norm2 = nn.LayerNorm(channels)

    def forward(self, tracks: Instances) -> Instances:
        """The tracks with new queries."""
        if len(tracks.scores) == 0:
            return tracks
        positions, contents = tracks.queries.chunk(2, -1)
        placed = positions + tracks.states
        hidden = self.norm1(tracks.states + self.self_attn(placed, placed, tracks.states))
        hidden = self.norm2(hidden + self.linear2(F.relu(self.linear1(hidden))))
        positions = self.norm_pos(positions + self.linear_pos2(F.relu(self.linear_pos1(hidden))))
        contents = self.norm_feat(contents + self.linear_feat2(F.relu(self.linear_feat1(hidden))))
        return replace(tracks, queries=torch.cat([positions, contents], -1))
