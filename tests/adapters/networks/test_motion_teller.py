"""What plans are told of the ego's motion."""

import torch

from adapters.networks.layers.ego_motion import CAN_BUS, CAN_BUS_INDICES, TYPICAL_VALUES, EgoStatusEncoder


def test_it_begins_with_nothing_to_tell_and_then_tells_speed_acceleration_and_yaw_rate_alone() -> None:
    teller, can_bus = EgoStatusEncoder(4), torch.arange(1.0, CAN_BUS + 1)
    assert torch.equal(teller(can_bus), torch.zeros(1, 4)) and list(teller.state_dict()) == ["tell.weight", "tell.bias"]
    with torch.no_grad():
        teller.tell.weight.copy_(torch.eye(4)[:, :3])
    expected = torch.tensor(
        [[(number + 1) / usual for number, usual in zip(CAN_BUS_INDICES, TYPICAL_VALUES, strict=True)] + [0.0]]
    )
    torch.testing.assert_close(teller(can_bus), expected)
    others = torch.ones(CAN_BUS, dtype=torch.bool)
    others[list(CAN_BUS_INDICES)] = False
    assert torch.equal(teller(can_bus + others), teller(can_bus))
