from dataclasses import replace

import numpy as np
import torch

from omniocc.camera import Equirectangular
from omniworld.mesh.mesh import empty
from omniworld.render.capture import expose, render_pixels
from omniworld.render.caster import Caster
from omniworld.render.view import make_view
from omniworld.sensors.lidar import panorama_directions, scan_ego


def _record(rig, camera, snapshot, ego_car, sensor, supersample=2):
    view = make_view(rig, camera, supersample, Caster(ego_car))
    return expose(view, render_pixels(view, snapshot), snapshot.light, sensor, np.random.default_rng(camera))


def test_range_is_exact_along_the_rigs_rays(rig, snapshot_of, quad, ego_car, noon, sensor):
    """On an endless plane 2.2 m below the ego, range is height over the sine of the ray's downward angle."""
    ground = quad([[-2000, -2000, 0], [2000, -2000, 0], [2000, 2000, 0], [-2000, 2000, 0]], 1)
    snapshot = snapshot_of(ground, empty(), empty(), noon)
    for camera in (0, 2, 5):
        directions, valid = (part.numpy() for part in rig.rays(camera))
        image = _record(rig, camera, snapshot, empty(), sensor)
        down = valid & (directions[..., 2] < -0.01)
        height = 2.2 + float(rig.ego_from_camera[camera, 2, 3])
        np.testing.assert_allclose(image.range_m[down], height / -directions[..., 2][down], rtol=2e-5)
        assert (image.label[down] == 1).all()
        sky = valid & (directions[..., 2] > 0.01)
        assert np.isposinf(image.range_m[sky]).all()
        assert (image.label[sky] == 0).all()


def test_outside_the_lens_is_black_and_unknown(rig, snapshot, ego_car, sensor):
    image = _record(rig, 0, snapshot, ego_car, sensor)
    outside = ~rig.rays(0)[1].numpy()
    assert 0.02 < outside.mean() < 0.5
    assert (image.rgb[outside] == 0).all()
    assert (image.label[outside] == 255).all()
    assert np.isnan(image.range_m[outside]).all()
    assert image.rgb[~outside].mean() > 40


def test_ego_car_is_seen_at_the_bottom_and_has_no_range(rig, snapshot, ego_car, sensor):
    image = _record(rig, 0, snapshot, ego_car, sensor)
    ego = (image.label == 255) & rig.rays(0)[1].numpy()
    rows = np.flatnonzero(ego.any(axis=1))
    assert rows[-1] == 35
    assert rows[0] > 18
    assert np.isnan(image.range_m[ego]).all()
    red, green, _ = image.rgb[ego].astype(float).mean(axis=0)
    assert red > 1.3 * green


def test_cameras_and_lidar_agree_on_points_that_both_see(rig, snapshot, ego_car, sensor):
    """Seen from the ego origin, the point of a pixel has the same class unless another object hides it."""
    agree, same = [], []
    for camera in range(6):
        image = _record(rig, camera, snapshot, ego_car, sensor)
        directions = rig.rays(camera)[0].numpy()
        finite = np.isfinite(image.range_m)
        points = rig.ego_from_camera[camera, :3, 3].numpy() + directions[finite] * image.range_m[finite][:, None]
        distance = np.linalg.norm(points, axis=1)
        range_m, labels = scan_ego(snapshot, (points / distance[:, None]).astype(np.float32).T)
        open_view = range_m > distance - 1e-3 * distance
        agree.append(np.abs(range_m[open_view] - distance[open_view]) < 2e-3 * distance[open_view])
        same.append(labels[open_view] == image.label[finite][open_view])
        assert open_view.mean() > 0.8
    assert np.concatenate(agree).mean() > 0.985  # rays that graze edges may differ
    assert np.concatenate(same).mean() > 0.985


def test_supersampling_changes_colours_at_borders_only(rig, snapshot, ego_car, sensor):
    once, smooth = (_record(rig, 0, snapshot, ego_car, sensor, s) for s in (1, 3))
    assert np.array_equal(once.label, smooth.label)
    assert np.array_equal(once.range_m, smooth.range_m, equal_nan=True)
    changed = (once.rgb != smooth.rgb).any(axis=-1)
    assert 0.02 < changed.mean() < 0.6
    view = make_view(rig, 0, 3, Caster(ego_car))
    rays = view.extra.shape[2]
    label, other = (
        np.where(hits.face >= 0, snapshot.surfaces.label[hits.face], 0)
        for hits in (snapshot.cast(view.origin_m, part.reshape(3, -1)) for part in (view.center, view.extra))
    )
    mixed = (other.reshape(-1, rays) != label[:, None]).any(axis=1)
    mixed &= (view.ego_center_hits.face < 0) & (view.ego_extra_hits.face < 0).reshape(-1, rays).all(axis=1)
    assert mixed.sum() > 50
    assert changed.ravel()[view.pixel[mixed]].mean() > 0.95


def test_a_pixel_on_an_edge_shows_both_sides_in_proportion(rig, snapshot_of, quad, ego_car, noon):
    """At a wall's upper edge before an even sky, colours are mixed by the fractions of rays that hit each."""
    wall = quad([[10, -40, 0], [10, 40, 0], [10, 40, 3.3], [10, -40, 3.3]], 4)
    snapshot = snapshot_of(wall, empty(), empty(), replace(noon, glow=0.0, cloud_cover=0.0, zenith=noon.horizon))
    view = make_view(rig, 0, 2, Caster(empty()))
    smooth, once = render_pixels(view, snapshot), render_pixels(replace(view, extra=view.extra[:, :, :0]), snapshot)
    on_wall = snapshot.cast(view.origin_m, view.extra.reshape(3, -1)).face.reshape(-1, 3) >= 0
    fraction = (on_wall.sum(axis=1) + (once.label == 4)) / 4
    sky = once.color[:, once.label == 0].mean(axis=1)
    edge = np.flatnonzero((fraction > 0) & (fraction < 1) & (once.label == 4))
    assert len(edge) > 10
    expected = fraction[edge] * once.color[:, edge] + (1 - fraction[edge]) * sky[:, None]
    np.testing.assert_allclose(smooth.color[:, edge], expected, atol=0.03)


def test_mask_of_the_rig_blanks_pixels(rig, snapshot, ego_car, sensor):
    mask = torch.ones(36, 64, dtype=torch.bool)
    mask[10:14, 30:40] = False
    image = _record(replace(rig, masks=(mask, *[None] * 5)), 0, snapshot, ego_car, sensor)
    assert (image.label[10:14, 30:40] == 255).all()
    assert (image.rgb[10:14, 30:40] == 0).all()


def test_panorama_follows_the_column_and_row_convention():
    directions = panorama_directions(8, 4, 40.0, -40.0).reshape(3, 4, 8)
    azimuth = np.degrees(np.arctan2(directions[1], directions[0]))
    np.testing.assert_allclose(azimuth[0], [157.5, 112.5, 67.5, 22.5, -22.5, -67.5, -112.5, -157.5], atol=1e-4)
    elevation = np.degrees(np.arcsin(directions[2]))
    np.testing.assert_allclose(elevation[:, 0], [30, 10, -10, -30], atol=1e-4)


def test_panorama_agrees_with_the_camera_model():
    model = Equirectangular(12, 6, 45.0, -45.0)
    rows, columns = torch.meshgrid(torch.arange(6.0), torch.arange(12.0), indexing="ij")
    rays, _ = model.unproject(torch.stack([columns, rows], dim=-1))
    ours = panorama_directions(12, 6, 45.0, -45.0).reshape(3, 6, 12)
    np.testing.assert_allclose(np.moveaxis(ours, 0, -1), rays.numpy(), atol=1e-6)
