"""The themes by name."""

from omniocc.world.material import Material
from omniocc.world.theme import Theme

_GRASS = ((Material.GRASS, (86, 118, 58)), (Material.GRASS, (104, 122, 66)), (Material.GRASS, (78, 104, 50)))
_PLASTER = ((222, 208, 180), (205, 192, 172), (196, 150, 118), (230, 226, 214), (172, 178, 182), (214, 186, 140))
_BRICK = ((150, 78, 58), (132, 72, 60), (168, 104, 76), (120, 92, 80))

DOWNTOWN = Theme(
    name="downtown",
    spacing_m=98.0, jitter_m=5.0, bulge_m=2.0, lanes=(2, 2, 2, 2, 1), lane_width_m=3.3, parking_m=2.3, sidewalk_m=4.2,
    corner_radius_m=7.0, paved_share=1.0, slope=0.05, horizon_m=14.0, skyline_m=24.0, lamp="street",
    plots={"tower": 4.0, "row": 5.0, "park": 1.0, "lot": 0.6},
    plot_width_m=(14.0, 26.0), setback_m=(1.0, 6.0),
    ground=((Material.CONCRETE, (150, 146, 140)), (Material.PAVING, (158, 148, 138)), (Material.GRASS, (92, 120, 62))),
    wall_colors=_PLASTER + _BRICK + ((120, 128, 138), (92, 100, 112)),
    roof_colors=((96, 92, 90), (120, 112, 104), (80, 84, 88)),
    trees={"round": 5.0, "tall": 2.0, "young": 3.0},
    tree_gap_m=13.0, lamp_gap_m=27.0, prop_gap_m=11.0, parked_gap_m=19.0,
    props={"bench": 3.0, "bin": 4.0, "hydrant": 2.0, "shelter": 1.0, "kiosk": 1.0, "box": 2.0, "bollards": 2.0, "planter": 2.0,
           "post": 2.0},
    guard_rail_share=0.0, speed_mps=(8.0, 12.0), car_headway_s=9.0, walkers_per_block=16.0,
)  # fmt: skip

SUBURB = Theme(
    name="suburb",
    spacing_m=92.0, jitter_m=6.0, bulge_m=5.0, lanes=(1, 2), lane_width_m=3.5, parking_m=2.5, sidewalk_m=3.2,
    corner_radius_m=8.0, paved_share=1.0, slope=0.06, horizon_m=22.0, skyline_m=8.0, lamp="street",
    plots={"house": 10.0, "park": 0.8, "row": 0.7},
    plot_width_m=(14.0, 21.0), setback_m=(5.0, 9.0),
    ground=_GRASS,
    wall_colors=_PLASTER + _BRICK + ((236, 232, 220), (150, 164, 170)),
    roof_colors=((142, 70, 52), (118, 62, 50), (84, 78, 76), (104, 84, 72), (66, 70, 76)),
    trees={"round": 5.0, "tall": 2.0, "conifer": 2.0, "birch": 2.0, "young": 2.0},
    tree_gap_m=15.0, lamp_gap_m=30.0, prop_gap_m=17.0, parked_gap_m=30.0,
    props={"bin": 4.0, "hydrant": 2.0, "bench": 1.0, "post": 2.0, "box": 2.0, "crates": 1.0, "shelter": 0.6},
    guard_rail_share=0.0, speed_mps=(6.0, 9.0), car_headway_s=11.0, walkers_per_block=8.0,
)  # fmt: skip

INDUSTRIAL = Theme(
    name="industrial",
    spacing_m=104.0, jitter_m=5.0, bulge_m=3.0, lanes=(2, 2, 1), lane_width_m=3.6, parking_m=2.6, sidewalk_m=3.3,
    corner_radius_m=9.0, paved_share=0.85, slope=0.045, horizon_m=16.0, skyline_m=8.0, lamp="street",
    plots={"hall": 6.0, "yard": 1.6, "lot": 1.2, "row": 1.0},
    plot_width_m=(24.0, 38.0), setback_m=(5.0, 11.0),
    ground=((Material.CONCRETE, (142, 140, 136)), (Material.SOIL, (132, 116, 94)), (Material.GRASS, (112, 118, 70))),
    wall_colors=((188, 190, 190), (140, 150, 160), (170, 160, 140), (120, 140, 150), (150, 84, 66), (206, 200, 186)),
    roof_colors=((110, 112, 114), (136, 138, 140), (94, 88, 84)),
    trees={"young": 4.0, "tall": 3.0, "round": 2.0, "bush": 2.0},
    tree_gap_m=26.0, lamp_gap_m=32.0, prop_gap_m=16.0, parked_gap_m=30.0,
    props={"crates": 4.0, "box": 3.0, "bin": 2.0, "bollards": 2.0, "hydrant": 2.0, "pallets": 3.0, "post": 1.0, "shelter": 0.6},
    guard_rail_share=0.7, speed_mps=(7.0, 12.0), car_headway_s=9.0, walkers_per_block=6.0,
)  # fmt: skip

COUNTRYSIDE = Theme(
    name="countryside",
    spacing_m=106.0, jitter_m=8.0, bulge_m=6.0, lanes=(1, 2), lane_width_m=3.7, parking_m=2.2, sidewalk_m=2.7,
    corner_radius_m=10.0, paved_share=0.75, slope=0.065, horizon_m=40.0, skyline_m=7.0, lamp="utility",
    plots={"field": 6.0, "farm": 3.0, "house": 3.0, "park": 1.0},
    plot_width_m=(22.0, 34.0), setback_m=(5.0, 10.0),
    ground=(*_GRASS, (Material.SOIL, (128, 104, 74)), (Material.GRASS, (150, 146, 82))),
    wall_colors=(*_PLASTER, (150, 78, 58), (128, 60, 48), (140, 120, 96)),
    roof_colors=((142, 70, 52), (104, 84, 72), (84, 78, 76)),
    trees={"round": 5.0, "conifer": 3.0, "birch": 3.0, "tall": 2.0, "bush": 3.0},
    tree_gap_m=14.0, lamp_gap_m=45.0, prop_gap_m=24.0, parked_gap_m=60.0,
    props={"post": 4.0, "crates": 2.0, "bench": 2.0, "bales": 3.0, "box": 1.0, "bin": 1.0, "shelter": 0.8},
    guard_rail_share=0.6, speed_mps=(8.0, 12.0), car_headway_s=12.0, walkers_per_block=4.0,
)  # fmt: skip

ALL = {theme.name: theme for theme in (DOWNTOWN, SUBURB, INDUSTRIAL, COUNTRYSIDE)}
