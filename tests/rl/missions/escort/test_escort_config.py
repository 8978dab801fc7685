"""What a scenario of the escort may not say."""

import pytest
from refusal import assert_says, refusal


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("uav.camera.field_of_view_deg=0", ["uav.camera.field_of_view_deg", "greater than 1"]),
        ("uav.camera.field_of_view_deg=180", ["uav.camera.field_of_view_deg", "less than 179"]),
        ("radio.range=0", ["radio.range"]),
        ("course.speed=[2.0,0.8]", ["speed", "must not be above"]),
        ('escort.boats="tug"', ["escort.boats", "'tug'", "no such team"]),
        ("escort.start_distance=[500,200]", ["start_distance", "must not be above"]),
        ("escort.start_distance=[200,5000]", ["start_distance", "area / 2"]),
        ('stages.extra={team="ghost"}', ["stages.extra.team", "no such team"]),
        ('stages.extra={team="vessel"}', ["stages.extra.team", "script"]),
        ('escort.reports="some"', ["reports", "'all'"]),
        ("obstacles.fixed=[{north=5,east=0,radius=8,height=5}]", ["obstacles.fixed[0]", "the vessel begins"]),
    ],
)
def test_a_wrong_scenario_is_refused_by_name(override, words):
    assert_says(refusal("escort", override), *words)
