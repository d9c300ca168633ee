"""The themes by name."""

from omniocc.world.material import Material
from omniocc.world.theme import Theme

_GRASS = ((Material.GRASS, (86, 118, 58)), (Material.GRASS, (104, 122, 66)), (Material.GRASS, (78, 104, 50)))
_PLASTER = ((222, 208, 180), (205, 192, 172), (196, 150, 118), (230, 226, 214), (172, 178, 182), (214, 186, 140))
_BRICK = ((150, 78, 58), (132, 72, 60), (168, 104, 76), (120, 92, 80))

DOWNTOWN = Theme(
    name="downtown",
    spacing_m=98, jitter_m=5, bulge_m=2, lanes=(2, 2, 2, 2, 1), lane_width_m=3.3, parking_m=2.3, sidewalk_m=4.2,
    corner_radius_m=7, paved_share=1.0, slope=0.05, horizon_m=14,
    plots={"tower": 4, "row": 5, "park": 1, "lot": 0.6},
    plot_width_m=(14, 26), setback_m=(1.0, 6.0),
    ground=((Material.CONCRETE, (150, 146, 140)), (Material.PAVING, (158, 148, 138)), (Material.GRASS, (92, 120, 62))),
    wall_colors=_PLASTER + _BRICK + ((120, 128, 138), (92, 100, 112)),
    roof_colors=((96, 92, 90), (120, 112, 104), (80, 84, 88)),
    trees={"round": 5, "tall": 2, "young": 3},
    tree_gap_m=13, lamp_gap_m=27, prop_gap_m=11, parked_gap_m=19,
    props={"bench": 3, "bin": 4, "hydrant": 2, "shelter": 1, "kiosk": 1, "box": 2, "bollards": 2, "planter": 2,
           "post": 2},
    guard_rail_share=0, speed_mps=(8, 12), car_headway_s=9, walkers_per_block=16,
)  # fmt: skip

SUBURB = Theme(
    name="suburb",
    spacing_m=92, jitter_m=6, bulge_m=5, lanes=(1, 2), lane_width_m=3.5, parking_m=2.5, sidewalk_m=3.2,
    corner_radius_m=8, paved_share=1.0, slope=0.06, horizon_m=22,
    plots={"house": 10, "park": 0.8, "row": 0.7},
    plot_width_m=(14, 21), setback_m=(5.0, 9.0),
    ground=_GRASS,
    wall_colors=_PLASTER + _BRICK + ((236, 232, 220), (150, 164, 170)),
    roof_colors=((142, 70, 52), (118, 62, 50), (84, 78, 76), (104, 84, 72), (66, 70, 76)),
    trees={"round": 5, "tall": 2, "conifer": 2, "birch": 2, "young": 2},
    tree_gap_m=15, lamp_gap_m=30, prop_gap_m=17, parked_gap_m=30,
    props={"bin": 4, "hydrant": 2, "bench": 1, "post": 2, "box": 2, "crates": 1, "shelter": 0.6},
    guard_rail_share=0, speed_mps=(6, 9), car_headway_s=11, walkers_per_block=8,
)  # fmt: skip

INDUSTRIAL = Theme(
    name="industrial",
    spacing_m=104, jitter_m=5, bulge_m=3, lanes=(2, 2, 1), lane_width_m=3.6, parking_m=2.6, sidewalk_m=3.3,
    corner_radius_m=9, paved_share=0.85, slope=0.045, horizon_m=16,
    plots={"hall": 6, "yard": 1.6, "lot": 1.2, "row": 1},
    plot_width_m=(24, 38), setback_m=(5.0, 11.0),
    ground=((Material.CONCRETE, (142, 140, 136)), (Material.SOIL, (132, 116, 94)), (Material.GRASS, (112, 118, 70))),
    wall_colors=((188, 190, 190), (140, 150, 160), (170, 160, 140), (120, 140, 150), (150, 84, 66), (206, 200, 186)),
    roof_colors=((110, 112, 114), (136, 138, 140), (94, 88, 84)),
    trees={"young": 4, "tall": 3, "round": 2, "bush": 2},
    tree_gap_m=26, lamp_gap_m=32, prop_gap_m=16, parked_gap_m=30,
    props={"crates": 4, "box": 3, "bin": 2, "bollards": 2, "hydrant": 2, "pallets": 3, "post": 1, "shelter": 0.6},
    guard_rail_share=0.7, speed_mps=(7, 12), car_headway_s=9, walkers_per_block=6,
)  # fmt: skip

COUNTRYSIDE = Theme(
    name="countryside",
    spacing_m=106, jitter_m=8, bulge_m=6, lanes=(1, 2), lane_width_m=3.7, parking_m=2.2, sidewalk_m=2.7,
    corner_radius_m=10, paved_share=0.75, slope=0.065, horizon_m=40,
    plots={"field": 6, "farm": 3, "house": 3, "park": 1},
    plot_width_m=(22, 34), setback_m=(5.0, 10.0),
    ground=(*_GRASS, (Material.SOIL, (128, 104, 74)), (Material.GRASS, (150, 146, 82))),
    wall_colors=(*_PLASTER, (150, 78, 58), (128, 60, 48), (140, 120, 96)),
    roof_colors=((142, 70, 52), (104, 84, 72), (84, 78, 76)),
    trees={"round": 5, "conifer": 3, "birch": 3, "tall": 2, "bush": 3},
    tree_gap_m=14, lamp_gap_m=45, prop_gap_m=24, parked_gap_m=60,
    props={"post": 4, "crates": 2, "bench": 2, "bales": 3, "box": 1, "bin": 1, "shelter": 0.8},
    guard_rail_share=0.6, speed_mps=(8, 12), car_headway_s=12, walkers_per_block=4,
)  # fmt: skip

ALL = {theme.name: theme for theme in (DOWNTOWN, SUBURB, INDUSTRIAL, COUNTRYSIDE)}
