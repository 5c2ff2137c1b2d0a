"""Brenner's robot through the main path: a reference without headings."""


def test_the_fused_path_is_much_better_than_the_wheels(estimated):
    result = estimated("brenner", "brenner")
    errors = {name: metrics["ate_rmse"]["value"] for name, metrics in result.metrics.items()}
    assert errors["fused"] < 0.429
    assert errors["fused"] < 0.6 * errors["wheels"]
    assert len(result.trajectories["lidar"]) == 278
    assert not result.trajectories["truth"].has_heading
