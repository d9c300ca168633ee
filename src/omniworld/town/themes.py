"""The eight themes; a new one is another `Theme` in `ALL`."""

from omniworld.mesh.material import Material
from omniworld.town.theme import Theme

_GRASS = ((Material.GRASS, (86, 118, 58)), (Material.GRASS, (104, 122, 66)), (Material.GRASS, (78, 104, 50)))
_PLASTER = ((222, 208, 180), (205, 192, 172), (196, 150, 118), (230, 226, 214), (172, 178, 182), (214, 186, 140))
_BRICK = ((150, 78, 58), (132, 72, 60), (168, 104, 76), (120, 92, 80))
_MIXED = {"sedan": 4.0, "hatchback": 3.0, "suv": 3.0, "van": 1.4, "truck": 0.8, "bus": 0.6, "bicycle": 0.5}
_LIGHT = {"sedan": 3.0, "hatchback": 4.0, "suv": 1.5, "van": 0.8, "bicycle": 1.0}


DOWNTOWN = Theme(
    name="downtown",
    spacing_m=98.0, jitter_m=5.0, bulge_m=2.0, straight_m=24.0, lanes=(2, 2, 2, 2, 1),
    lane_width_m=3.3, parking_m=2.3, sidewalk_m=4.2, corner_radius_m=7.0,
    slope=0.05, horizon_m=14.0, skyline_m=24.0, lamp="street",
    plots={"tower": 4.0, "row": 5.0, "park": 1.0, "lot": 0.6},
    plot_width_m=(14.0, 26.0), setback_m=(1.0, 6.0), infill=True,
    ground=((Material.CONCRETE, (150, 146, 140)), (Material.PAVING, (158, 148, 138)), (Material.GRASS, (92, 120, 62))),
    wall_colors=_PLASTER + _BRICK + ((120, 128, 138), (92, 100, 112)),
    roof_colors=((96, 92, 90), (120, 112, 104), (80, 84, 88)),
    trees={"round": 5.0, "tall": 2.0, "young": 3.0},
    tree_gap_m=13.0, lamp_gap_m=27.0, prop_gap_m=11.0, parked_gap_m=26.0,
    props={"bench": 3.0, "bin": 4.0, "hydrant": 2.0, "shelter": 1.0, "kiosk": 1.0, "box": 2.0, "bollards": 2.0,
           "planter": 2.0, "post": 2.0},
    speed_mps=(8.0, 12.0), traffic=_MIXED, car_headway_s=4.0, walkers_per_block=16.0,
)  # fmt: skip

SUBURB = Theme(
    name="suburb",
    spacing_m=92.0, jitter_m=6.0, bulge_m=5.0, straight_m=24.0, lanes=(1, 2),
    lane_width_m=3.5, parking_m=2.5, sidewalk_m=3.2, corner_radius_m=8.0,
    slope=0.06, horizon_m=22.0, skyline_m=8.0, lamp="street",
    plots={"house": 10.0, "park": 0.8, "row": 0.7},
    plot_width_m=(14.0, 21.0), setback_m=(5.0, 9.0),
    ground=_GRASS,
    wall_colors=_PLASTER + _BRICK + ((236, 232, 220), (150, 164, 170)),
    roof_colors=((142, 70, 52), (118, 62, 50), (84, 78, 76), (104, 84, 72), (66, 70, 76)),
    trees={"round": 5.0, "tall": 2.0, "conifer": 2.0, "birch": 2.0, "young": 2.0},
    tree_gap_m=15.0, lamp_gap_m=30.0, prop_gap_m=17.0, parked_gap_m=42.0,
    props={"bin": 4.0, "hydrant": 2.0, "bench": 1.0, "post": 2.0, "box": 2.0, "crates": 1.0, "shelter": 0.6},
    speed_mps=(6.0, 9.0), traffic=_MIXED, car_headway_s=5.0, walkers_per_block=8.0,
)  # fmt: skip

INDUSTRIAL = Theme(
    name="industrial",
    spacing_m=104.0, jitter_m=5.0, bulge_m=3.0, straight_m=24.0, lanes=(2, 2, 1),
    lane_width_m=3.6, parking_m=2.6, sidewalk_m=3.3, corner_radius_m=9.0,
    paved_fraction=0.85, slope=0.045, horizon_m=16.0, skyline_m=8.0, lamp="street",
    plots={"hall": 6.0, "yard": 1.6, "lot": 1.2, "row": 1.0},
    plot_width_m=(24.0, 38.0), setback_m=(5.0, 11.0),
    ground=((Material.CONCRETE, (142, 140, 136)), (Material.SOIL, (132, 116, 94)), (Material.GRASS, (112, 118, 70))),
    wall_colors=((188, 190, 190), (140, 150, 160), (170, 160, 140), (120, 140, 150), (150, 84, 66), (206, 200, 186)),
    roof_colors=((110, 112, 114), (136, 138, 140), (94, 88, 84)),
    trees={"young": 4.0, "tall": 3.0, "round": 2.0, "bush": 2.0},
    tree_gap_m=26.0, lamp_gap_m=32.0, prop_gap_m=16.0, parked_gap_m=42.0,
    props={"crates": 4.0, "box": 3.0, "bin": 2.0, "bollards": 2.0, "hydrant": 2.0, "pallets": 3.0, "post": 1.0,
           "shelter": 0.6},
    guard_rail_fraction=0.7, speed_mps=(7.0, 12.0),
    traffic=_MIXED, car_headway_s=4.0, walkers_per_block=6.0,
)  # fmt: skip

COUNTRYSIDE = Theme(
    name="countryside",
    spacing_m=106.0, jitter_m=8.0, bulge_m=6.0, straight_m=24.0, lanes=(1, 2),
    lane_width_m=3.7, parking_m=2.2, sidewalk_m=2.7, corner_radius_m=10.0,
    paved_fraction=0.4, slope=0.065, horizon_m=40.0, skyline_m=7.0, lamp="utility",
    plots={"field": 6.0, "farm": 3.0, "house": 3.0, "park": 1.0},
    plot_width_m=(22.0, 34.0), setback_m=(5.0, 10.0),
    ground=(*_GRASS, (Material.SOIL, (128, 104, 74)), (Material.GRASS, (150, 146, 82))),
    wall_colors=(*_PLASTER, (150, 78, 58), (128, 60, 48), (140, 120, 96)),
    roof_colors=((142, 70, 52), (104, 84, 72), (84, 78, 76)),
    trees={"round": 5.0, "conifer": 3.0, "birch": 3.0, "tall": 2.0, "bush": 3.0},
    tree_gap_m=14.0, lamp_gap_m=45.0, prop_gap_m=24.0, parked_gap_m=60.0,
    props={"post": 4.0, "crates": 2.0, "bench": 2.0, "bales": 3.0, "box": 1.0, "bin": 1.0, "shelter": 0.8},
    guard_rail_fraction=0.6, speed_mps=(8.0, 12.0),
    traffic=_MIXED, car_headway_s=6.0, walkers_per_block=4.0,
)  # fmt: skip

_WARM = ((226, 196, 150), (208, 160, 112), (222, 208, 180), (196, 132, 104), (236, 222, 196), (178, 150, 130))

OLD_TOWN = Theme(
    name="oldtown",
    spacing_m=74.0, jitter_m=8.0, bulge_m=6.5, straight_m=14.0, lanes=(1,), lane_width_m=2.95, parking_m=0.3,
    sidewalk_m=1.9, corner_radius_m=4.5, road=(Material.PAVING, 92, 124), lane_lines=False,
    slope=0.075, horizon_m=26.0, skyline_m=10.0, lamp="park",
    plots={"row": 12.0, "square": 0.9, "church": 0.6},
    plot_width_m=(8.0, 15.0), setback_m=(0.0, 0.3), infill=True,
    ground=((Material.PAVING, (150, 140, 124)), (Material.SOIL, (128, 110, 88)), (Material.GRASS, (96, 112, 64))),
    wall_colors=_WARM, roof_colors=((150, 74, 52), (132, 66, 50), (122, 84, 66)),
    trees={"round": 3.0, "young": 3.0, "bush": 2.0},
    tree_gap_m=46.0, lamp_gap_m=19.0, prop_gap_m=13.0, parked_gap_m=float("inf"),
    props={"bollards": 3.0, "planter": 4.0, "bin": 2.0, "bench": 2.0, "post": 1.0, "hydrant": 1.0},
    speed_mps=(4.5, 7.0), traffic=_LIGHT,
    car_headway_s=9.0, walkers_per_block=18.0,
)  # fmt: skip

ARTERIAL = Theme(
    name="arterial",
    spacing_m=124.0, jitter_m=5.0, bulge_m=3.0, straight_m=30.0, lanes=(3, 3, 2), lane_width_m=3.4, parking_m=0.8,
    sidewalk_m=3.4, corner_radius_m=10.0,
    paved_fraction=0.85, slope=0.04, horizon_m=16.0, skyline_m=16.0, lamp="street",
    plots={"tower": 3.0, "hall": 2.0, "lot": 2.0, "park": 1.0, "row": 1.0},
    plot_width_m=(20.0, 34.0), setback_m=(5.0, 12.0),
    ground=((Material.GRASS, (100, 118, 64)), (Material.CONCRETE, (146, 144, 138)), (Material.GRASS, (88, 108, 58))),
    wall_colors=(*_PLASTER, (120, 128, 138), (92, 100, 112), (150, 84, 66)),
    roof_colors=((96, 92, 90), (120, 112, 104), (80, 84, 88)),
    trees={"tall": 4.0, "young": 4.0, "round": 3.0},
    tree_gap_m=18.0, lamp_gap_m=26.0, prop_gap_m=24.0, parked_gap_m=float("inf"),
    props={"shelter": 2.0, "bin": 2.0, "box": 3.0, "bollards": 1.0, "post": 1.0, "hydrant": 1.0},
    median_m=1.7, railway=True, guard_rail_fraction=0.8, speed_mps=(10.0, 14.0), traffic=_MIXED,
    car_headway_s=7.0, walkers_per_block=8.0,
)  # fmt: skip

CAMPUS = Theme(
    name="campus",
    spacing_m=108.0, jitter_m=9.0, bulge_m=10.0, straight_m=18.0, lanes=(1,), lane_width_m=3.1, parking_m=0.5,
    sidewalk_m=4.6, corner_radius_m=8.0, slope=0.06, horizon_m=24.0, skyline_m=9.0, lamp="park",
    plots={"green": 5.0, "college": 4.0, "park": 1.5, "square": 0.5, "lot": 0.5},
    plot_width_m=(28.0, 42.0), setback_m=(6.0, 13.0),
    ground=((Material.GRASS, (96, 128, 62)), (Material.GRASS, (86, 118, 58))),
    wall_colors=(*_BRICK, (206, 196, 176), (190, 180, 166)), roof_colors=((96, 92, 90), (84, 90, 84), (110, 84, 72)),
    trees={"round": 7.0, "tall": 2.0, "birch": 3.0, "conifer": 2.0, "bush": 2.0},
    tree_gap_m=10.0, lamp_gap_m=20.0, prop_gap_m=14.0, parked_gap_m=float("inf"),
    props={"bench": 5.0, "bin": 3.0, "planter": 2.0, "bollards": 2.0, "post": 1.0, "shelter": 0.5},
    speed_mps=(5.0, 8.0), traffic={**_LIGHT, "bicycle": 5.0}, car_headway_s=8.0, walkers_per_block=26.0,
)  # fmt: skip

ROUNDABOUT = Theme(
    name="roundabout",
    spacing_m=104.0, jitter_m=5.0, bulge_m=5.0, straight_m=30.0, lanes=(1,), lane_width_m=3.5, parking_m=2.3,
    sidewalk_m=3.4, corner_radius_m=13.0,
    paved_fraction=0.9, slope=0.055, horizon_m=30.0, skyline_m=9.0, lamp="street",
    plots={"row": 5.0, "house": 3.0, "park": 1.0, "church": 0.5, "square": 0.6, "lot": 0.5},
    plot_width_m=(15.0, 24.0), setback_m=(2.0, 6.0),
    ground=_GRASS,
    wall_colors=((236, 232, 224), (226, 222, 206), (210, 196, 170), (178, 112, 88), (200, 206, 204)),
    roof_colors=((70, 72, 78), (84, 78, 76), (118, 62, 50)),
    trees={"round": 4.0, "birch": 3.0, "conifer": 1.0, "young": 3.0, "tall": 1.0},
    tree_gap_m=16.0, lamp_gap_m=28.0, prop_gap_m=15.0, parked_gap_m=30.0,
    props={"bench": 2.0, "bin": 3.0, "shelter": 1.5, "planter": 2.0, "box": 2.0, "hydrant": 1.0, "post": 1.0},
    island_m=5.2, guard_rail_fraction=0.4, speed_mps=(7.0, 11.0), traffic=_MIXED,
    car_headway_s=5.0, walkers_per_block=9.0,
)  # fmt: skip

SOLIDS = Theme(
    name="solids",
    spacing_m=80.0, jitter_m=8.0, bulge_m=8.0, straight_m=14.0, lanes=(1,), lane_width_m=2.9, parking_m=0.2,
    sidewalk_m=0.8, corner_radius_m=5.0, lane_lines=False, paved_fraction=0.5,
    slope=0.02, horizon_m=20.0, skyline_m=10.0, lamp="park",
    plots={"solids": 1.0}, plot_width_m=(8.0, 20.0), setback_m=(0.0, 0.3),
    ground=((Material.PAVING, (150, 140, 124)), (Material.CONCRETE, (142, 140, 136)), (Material.SOIL, (128, 110, 88))),
    wall_colors=_WARM, roof_colors=((96, 92, 90),),
    trees={"bush": 1.0, "round": 1.0}, tree_gap_m=float("inf"), lamp_gap_m=60.0, prop_gap_m=20.0,
    parked_gap_m=float("inf"), props={"bollards": 1.0, "crates": 1.0, "planter": 1.0},
    speed_mps=(3.0, 6.0), traffic=_LIGHT, car_headway_s=20.0, walkers_per_block=10.0, hall_fraction=0.4,
)  # fmt: skip

TOWNS = (DOWNTOWN, SUBURB, INDUSTRIAL, COUNTRYSIDE, OLD_TOWN, ARTERIAL, CAMPUS, ROUNDABOUT)

ALL = {theme.name: theme for theme in (*TOWNS, SOLIDS)}
