"""The parameters of a theme (a 'map'): its streets, plots, objects and traffic."""

from dataclasses import dataclass

from omniworld.mesh.material import Material
from omniworld.mesh.shape import Color


@dataclass(frozen=True, kw_only=True)
class Theme:
    """Recipe of a place. Weights are relative frequencies; spacings are along the street, in metres.

    Attributes:
        name: the key in `omniworld.THEMES`.
        spacing_m, jitter_m: distance between junctions, and its scatter.
        bulge_m, straight_m: sideways bow of streets, and length of their straight ends.
        lanes: choices of lanes per direction of a street.
        lane_width_m, parking_m, sidewalk_m, corner_radius_m: cross-section; the kerb's radius at corners.
        road: material of the streets, and its darkest and lightest grey.
        lane_lines: whether lanes are marked.
        paved_fraction: fraction of blocks with a sidewalk; the others have a verge.
        slope, horizon_m, skyline_m: steepest slopes (rise over run), heights of hills and buildings on the horizon.
        lamp: kind of lamp post (`pole.KINDS`).
        plots: kind of plot (`plot.KINDS`) -> weight.
        plot_width_m, setback_m: least and greatest width of plots, and distance of buildings from their front.
        infill: whether narrow houses close the gaps between plots.
        ground: (material, colour) choices of the land inside blocks.
        wall_colors, roof_colors: of buildings.
        trees: kind (`tree.KINDS`) -> weight.
        tree_gap_m, lamp_gap_m, prop_gap_m, parked_gap_m: mean distance between objects along a street; inf for none.
        props: kind (`prop.KINDS`) -> weight.
        median_m: width of the strip between the directions; 0 for none.
        island_m: radius of the islands where four streets meet; 0 for none.
        railway: whether a railway crosses the town on pillars.
        guard_rail_fraction: fraction of verges behind a guard rail.
        speed_mps: least and greatest speed of free traffic on a street.
        traffic: kind (`vehicle.KINDS`) -> weight among moving vehicles.
        car_headway_s: least time between cars of one lane at the start of the traffic.
        walkers_per_block: mean number of walkers around a block whose sidewalk is 340 m long.
        hall_fraction: fraction of places that are a hall: walls along the kerbs, and a ceiling over everything.
    """

    name: str
    spacing_m: float
    jitter_m: float
    bulge_m: float
    straight_m: float
    lanes: tuple[int, ...]
    lane_width_m: float
    parking_m: float
    sidewalk_m: float
    corner_radius_m: float
    road: tuple[Material, int, int] = (Material.ASPHALT, 62, 104)
    lane_lines: bool = True
    paved_fraction: float = 1.0
    slope: float
    horizon_m: float
    skyline_m: float
    lamp: str
    plots: dict[str, float]
    plot_width_m: tuple[float, float]
    setback_m: tuple[float, float]
    infill: bool = False
    ground: tuple[tuple[Material, Color], ...]
    wall_colors: tuple[Color, ...]
    roof_colors: tuple[Color, ...]
    trees: dict[str, float]
    tree_gap_m: float
    lamp_gap_m: float
    prop_gap_m: float
    parked_gap_m: float
    props: dict[str, float]
    median_m: float = 0.0
    island_m: float = 0.0
    railway: bool = False
    guard_rail_fraction: float = 0.0
    speed_mps: tuple[float, float]
    traffic: dict[str, float]
    car_headway_s: float
    walkers_per_block: float
    hall_fraction: float = 0.0
