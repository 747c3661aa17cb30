import math

import numpy as np
import pytest

from orogen.camera import Camera
from orogen.frame import Frame
from orogen.grid import Grid
from orogen.view.controls import Ground, OrbitControls
from orogen.view.flying import FlyControls, WalkControls

DEGREES = Grid(1201, 1201, (1 / 1200, 0.0, -122.0, 0.0, -1 / 1200, 47.0), "EPSG:4326", (76000.0, 111200.0))
ROTATED = Grid(4000, 9000, (8.0, 6.0, 5e5, 6.0, -8.0, 4e6), "EPSG:32633")
SIZE = (800.0, 600.0)
RATIO = 1.5
LEVEL = 700.0
EXAGGERATION = 2.0


class World:
    """Flat ground at LEVEL metres, seen by controls; what is picked is intersected with the frame's own rays."""

    def __init__(self, grid, controls, orthographic=None, pitch=-35.0, height=6000.0, sky=False):
        self.grid = grid
        self.sky = sky
        x, y = (float(v) for v in grid.to_crs(grid.width / 2, grid.height / 2))
        z = EXAGGERATION * LEVEL + height
        camera = Camera(x, y, z, heading=30.0, pitch=pitch, orthographic=orthographic)
        ground = Ground(grid, lambda x, y: LEVEL, self.pick, EXAGGERATION)
        self.picks = []
        self.controls = controls(camera, ground, SIZE, RATIO)

    def frame(self):
        size = (round(self.controls.size[0] * RATIO), round(self.controls.size[1] * RATIO))
        return Frame(self.controls.camera, self.grid, size, height_range=(LEVEL, LEVEL), exaggeration=EXAGGERATION)

    def pick(self, column, row):
        self.picks.append((column, row))
        if self.sky:
            return None
        frame = self.frame()
        origin, direction = (a[row, column] for a in frame.rays())
        camera = frame.camera
        along = (EXAGGERATION * LEVEL - camera.z - origin[2]) / direction[2]
        if along < 0 and not camera.orthographic:
            return None
        point = origin + along * direction
        scale = self.grid.ground_scale
        return camera.x + point[0] / scale[0], camera.y + point[1] / scale[1], LEVEL

    def on_screen(self, point):
        """Logical pixel position of (x, y, height in metres), by the frame's matrix."""
        frame = self.frame()
        camera, scale = frame.camera, self.grid.ground_scale
        relative = [(point[0] - camera.x) * scale[0], (point[1] - camera.y) * scale[1]]
        clip = frame.view_projection @ [*relative, EXAGGERATION * point[2] - camera.z, 1.0]
        u, v = clip[:2] / clip[3]
        return (u + 1) / 2 * SIZE[0], (1 - v) / 2 * SIZE[1]

    def send(self, kind, **event):
        event = {"modifiers": (), "button": 1, **event, "event_type": kind}
        return self.controls.handle(event)

    def drag(self, start, end, steps=4, dt=0.05, **event):
        self.send("pointer_down", x=start[0], y=start[1], **event)
        for s in np.linspace(0, 1, steps + 1)[1:]:
            x, y = np.array(start) * (1 - s) + np.array(end) * s
            self.send("pointer_move", x=x, y=y)
            self.controls.advance(dt)

    def settle(self, limit=20.0, dt=1 / 60):
        """Let time pass until nothing moves; gives the seconds it took."""
        for i in range(round(limit / dt)):
            if not self.controls.moving:
                return i * dt
            self.controls.advance(dt)
        raise AssertionError("the camera never comes to rest")


WORLDS = pytest.mark.parametrize(
    ("grid", "orthographic"),
    [(DEGREES, None), (DEGREES, 9000.0), (ROTATED, None), (ROTATED, 9000.0)],
    ids=["degrees", "degrees-orthographic", "rotated", "rotated-orthographic"],
)  # fmt: skip


@WORLDS
def test_panning_keeps_the_held_point_under_the_pointer(grid, orthographic):
    world = World(grid, OrbitControls, orthographic)
    before = world.controls.camera
    point = world.pick(450, 600)  # of which physical pixel (300.33, 400.33) is the centre
    world.drag((300.33, 400.33), (520.0, 310.0))
    assert world.on_screen(point) == pytest.approx((520.0, 310.0), abs=0.1)
    camera = world.controls.camera
    assert (camera.z, camera.heading, camera.pitch) == (before.z, before.heading, before.pitch)


@WORLDS
def test_turning_keeps_the_held_point_in_its_place(grid, orthographic):
    world = World(grid, OrbitControls, orthographic)
    point = world.pick(450, 600)
    place = world.on_screen(point)
    before = world.controls.camera
    world.drag((300.1, 400.1), (420.1, 460.1), button=2)
    camera = world.controls.camera
    assert camera.heading == pytest.approx(before.heading + 120 * 120 / 600)
    assert camera.pitch == pytest.approx(before.pitch - 60 * 120 / 600)
    assert world.on_screen(point) == pytest.approx(place, abs=1e-3)


@pytest.mark.parametrize(
    "event", [{"button": 2}, {"button": 3}, {"modifiers": ("Shift",)}, {"modifiers": ("Control",)}]
)
def test_what_turns(event):
    world = World(ROTATED, OrbitControls)
    world.drag((300, 400), (350, 400), **event)
    assert world.controls.camera.heading == pytest.approx(40.0)


@WORLDS
@pytest.mark.parametrize("notches", [-3.0, 2.0])
def test_zooming_goes_to_the_pointer(grid, orthographic, notches):
    world = World(grid, OrbitControls, orthographic)
    point = world.pick(450, 600)
    place = world.on_screen(point)
    before = world.controls.camera
    assert world.send("wheel", dx=0, dy=notches * 100, x=300.1, y=400.1)
    world.settle()
    camera = world.controls.camera
    factor = 1.25**notches
    level = EXAGGERATION * LEVEL
    if orthographic:
        assert camera.orthographic == pytest.approx(orthographic * factor)
    else:
        assert camera.z - level == pytest.approx((before.z - level) * factor)
    assert world.on_screen(point) == pytest.approx(place, abs=1e-3)


def test_a_double_click_goes_there():
    world = World(ROTATED, OrbitControls)
    before = world.controls.camera.z - EXAGGERATION * LEVEL
    world.send("double_click", x=300.0, y=400.0)
    world.settle()
    assert world.controls.camera.z - EXAGGERATION * LEVEL == pytest.approx(before * 1.25**-4)


def test_zooming_ends_above_the_ground_and_near_the_data():
    world = World(ROTATED, OrbitControls)
    for _ in range(5):
        world.send("wheel", dx=0, dy=-5000, x=400, y=300)
        world.settle()
    camera = world.controls.camera
    assert camera.z >= EXAGGERATION * LEVEL + world.controls.ground.clearance
    for _ in range(5):
        world.send("wheel", dx=0, dy=5000, x=400, y=300)
        world.settle()
    assert camera.z < world.controls.camera.z <= world.controls.ground.reach


def test_picks_are_physical_pixels():
    world = World(ROTATED, OrbitControls)
    world.send("pointer_down", x=100.4, y=200.9)
    assert world.picks == [(math.floor(150.6), math.floor(301.35))]
    world.send("resize", width=500.0, height=400.0, pixel_ratio=2.0)
    world.sky = True
    world.send("wheel", dx=0, dy=1, x=100.4, y=200.9)
    assert world.picks[-1] == (200, 401)
    assert world.controls.size == (500.0, 400.0)


def test_beside_the_data_the_ground_is_a_plane():
    world = World(ROTATED, OrbitControls)
    point = world.pick(600, 600)
    world.sky = True
    world.drag((400.33, 400.33), (500.0, 420.0))
    assert world.on_screen(point) == pytest.approx((500.0, 420.0), abs=0.5)


def test_the_sky_cannot_be_held():
    world = World(ROTATED, OrbitControls, pitch=20.0)
    before = world.controls.camera
    world.drag((400, 100), (500, 150))
    assert world.controls.camera == before
    assert not world.send("wheel", dx=0, dy=-100, x=400, y=100)
    world.send("pointer_up", x=500, y=150)
    assert not world.controls.moving


def test_a_drag_over_the_horizon_does_not_throw_the_camera_away():
    world = World(ROTATED, OrbitControls, pitch=-10.0)
    before = world.controls.camera
    world.drag((400, 500), (400, 0), steps=50)
    camera = world.controls.camera
    assert math.hypot(camera.x - before.x, camera.y - before.y) < 130e3


def test_inertia_follows_a_moving_release_and_fades():
    world = World(ROTATED, OrbitControls)
    point = world.pick(600, 600)
    world.drag((400.33, 400.33), (400.33, 300.33), steps=10, dt=0.02)
    world.send("pointer_up", x=400, y=300)
    seconds = world.settle()
    x, y = world.on_screen(point)
    # 500 pixels a second that fade with the time constant go on for some 75, fewer as the point goes farther away
    assert 0.2 < seconds < 3
    assert x == pytest.approx(400.33, abs=1)
    assert 220 < y < 260


def test_no_inertia_after_holding_still():
    world = World(ROTATED, OrbitControls)
    world.drag((400, 400), (400, 300), steps=10, dt=0.02)
    for _ in range(60):
        assert world.controls.moving
        world.controls.advance(0.02)
    released = world.controls.camera
    world.send("pointer_up", x=400, y=300)
    world.settle()
    camera = world.controls.camera
    assert math.hypot(camera.x - released.x, camera.y - released.y) < 1.0


def test_turns_fade_out_too():
    world = World(ROTATED, OrbitControls)
    world.drag((400, 400), (300, 400), steps=10, dt=0.02, button=2)
    point = world.pick(600, 600)
    released = world.controls.camera
    world.send("pointer_up", x=300, y=400)
    world.settle()
    change = (world.controls.camera.heading - released.heading + 180) % 360 - 180
    assert -60 < change < -1
    assert world.on_screen(point) == pytest.approx((400.33, 400.33), abs=0.5)


@pytest.mark.parametrize("controls", [OrbitControls, FlyControls])
def test_north_up(controls):
    world = World(ROTATED, controls)
    world.send("key_down", key="n")
    assert world.controls.moving
    seconds = world.settle()
    assert world.controls.camera.heading == 0
    assert 0.2 < seconds < 2


@pytest.mark.parametrize("controls", [OrbitControls, FlyControls])
def test_home(controls):
    world = World(ROTATED, controls)
    start = world.controls.camera
    world.drag((400, 400), (300, 350), button=2)
    world.send("pointer_up", x=300, y=350)
    world.settle()
    assert world.controls.camera != start
    world.send("key_down", key="Home")
    world.settle()
    assert world.controls.camera == start


@pytest.mark.parametrize(
    ("keys", "direction"),
    [("w", (0, 0, 1)), ("s", (0, 0, -1)), ("d", (1, 0, 0)), ("a", (-1, 0, 0)), ("W", (0, 0, 1)), ("wd", (1, 0, 1))],
)
def test_flying_along_the_view(keys, direction):
    world = World(ROTATED, FlyControls)
    before = world.controls.camera
    for key in keys:
        world.send("key_down", key=key)
    for _ in range(10):
        world.controls.advance(0.02)
    camera = world.controls.camera
    step = np.array([camera.x - before.x, camera.y - before.y, camera.z - before.z])
    assert step / np.linalg.norm(step) == pytest.approx(np.array(direction) / np.linalg.norm(direction) @ before.basis)


@pytest.mark.parametrize(("key", "sign"), [("e", 1), ("q", -1)])
def test_flying_up_and_down(key, sign):
    world = World(ROTATED, FlyControls)
    before = world.controls.camera
    world.send("key_down", key=key)
    world.controls.advance(0.1)
    camera = world.controls.camera
    assert (camera.x, camera.y) == (before.x, before.y)
    assert (camera.z - before.z) * sign > 0


def flown(height, *keys, seconds=1.0):
    world = World(ROTATED, FlyControls, height=height, pitch=0.0)
    before = world.controls.camera
    for key in keys:
        world.send("key_down", key=key)
    for _ in range(round(seconds / 0.01)):
        world.controls.advance(0.01)
    camera = world.controls.camera
    return math.hypot(camera.x - before.x, camera.y - before.y)


def test_speed_goes_with_the_height_over_the_ground():
    assert flown(4000.0, "w") == pytest.approx(4 * flown(1000.0, "w"))
    assert flown(4000.0, "w", "Shift") == pytest.approx(4 * flown(4000.0, "w"))
    # a height a second, less what starting takes
    assert flown(4000.0, "w", seconds=2.0) - flown(4000.0, "w") == pytest.approx(4000.0, rel=0.01)


def test_the_wheel_sets_the_speed():
    world = World(ROTATED, FlyControls)
    world.send("wheel", dx=0, dy=-100, x=0, y=0)
    assert world.controls.speed == pytest.approx(1.25)
    world.send("wheel", dx=0, dy=1e6, x=0, y=0)
    assert world.controls.speed == 0.05


def test_released_keys_let_the_camera_glide_to_rest():
    world = World(ROTATED, FlyControls)
    world.send("key_down", key="W", modifiers=("Shift",))
    assert world.controls.moving
    for _ in range(20):
        world.controls.advance(0.02)
    world.send("key_up", key="w")
    assert 0.3 < world.settle() < 3


def test_flying_never_goes_below_the_ground():
    world = World(ROTATED, FlyControls, pitch=-80.0)
    world.send("key_down", key="w")
    world.send("key_down", key="q")
    lowest = min(world.controls.advance(0.1).z for _ in range(300))
    assert lowest == pytest.approx(EXAGGERATION * LEVEL + world.controls.ground.clearance)


def test_orbiting_never_goes_below_the_ground():
    world = World(ROTATED, OrbitControls)
    world.drag((400, 300), (400, -2000), steps=40, button=2)
    assert world.controls.camera.z >= EXAGGERATION * LEVEL + world.controls.ground.clearance
    assert -90 <= world.controls.camera.pitch <= 89


def test_looking_around_while_flying():
    world = World(ROTATED, FlyControls)
    before = world.controls.camera
    world.drag((400, 300), (450, 330))
    camera = world.controls.camera
    assert (camera.x, camera.y, camera.z) == pytest.approx((before.x, before.y, before.z))
    assert camera.heading == pytest.approx(before.heading + 10)
    assert camera.pitch == pytest.approx(before.pitch - 6)
    world.send("pointer_up", x=450, y=330)
    assert not world.send("pointer_move", x=500, y=500)


def test_a_stall_does_not_throw_the_camera():
    world = World(ROTATED, FlyControls, pitch=0.0, height=1000.0)
    before = world.controls.camera
    world.send("key_down", key="w")
    camera = world.controls.advance(30.0)
    assert 0 < math.hypot(camera.x - before.x, camera.y - before.y) < 101


def test_without_ground_below_the_camera_flies_on():
    world = World(ROTATED, FlyControls, pitch=-45.0)
    controls = FlyControls(
        world.controls.camera, Ground(ROTATED, lambda x, y: math.nan, lambda c, r: None), SIZE, RATIO
    )
    controls.handle({"event_type": "key_down", "key": "w", "modifiers": ()})
    assert math.isfinite(controls.advance(0.1).z)
    assert controls.camera.z < world.controls.camera.z


@pytest.mark.parametrize("controls", [OrbitControls, FlyControls])
def test_what_means_nothing_asks_for_no_picture(controls):
    world = World(ROTATED, controls)
    assert not world.send("pointer_move", x=1, y=1)
    assert not world.send("key_down", key="F5")
    assert not world.send("key_up", key="F5")
    assert not world.controls.moving
    assert world.controls.advance(1.0) == world.controls.camera


def test_a_swipe_sideways_turns_about_what_is_under_the_pointer():
    world = World(ROTATED, OrbitControls)
    point = world.pick(450, 600)
    place = world.on_screen(point)
    before = world.controls.camera
    for _ in range(10):  # a touchpad sends many small steps, and never quite level ones
        world.send("wheel", dx=10.0, dy=1.0, x=300.33, y=400.33)
    assert world.controls.camera.heading == pytest.approx(before.heading + 10.0)
    assert not world.controls.moving
    assert world.on_screen(point) == pytest.approx(place, abs=0.1)


def test_many_small_notches_are_as_far_as_one():
    worlds = World(ROTATED, OrbitControls), World(ROTATED, OrbitControls)
    for _ in range(40):
        worlds[0].send("wheel", dx=0.5, dy=-2.5, x=300, y=400)
    worlds[1].send("wheel", dx=0.0, dy=-100.0, x=300, y=400)
    for world in worlds:
        world.settle()
    assert worlds[0].controls.camera.z == pytest.approx(worlds[1].controls.camera.z, rel=1e-6)


@pytest.mark.parametrize("controls", [OrbitControls, FlyControls])
def test_going_to_a_camera(controls):
    world = World(DEGREES, controls)
    start = world.controls.camera
    goal = start.moved(x=start.x + 0.1, y=start.y - 0.05, z=start.z + 900, heading=350.0, pitch=-60.0, fov=30.0)
    world.controls.go_to(goal)
    headings = []
    while world.controls.moving:
        world.controls.advance(1 / 60)
        headings.append(world.controls.camera.heading)
    assert world.controls.camera == goal
    assert all(heading <= 30.0 or heading >= 350.0 for heading in headings)  # the short way, through north
    assert 20 < len(headings) < 300
    world.controls.go_to(start)
    world.controls.advance(1 / 60)
    world.send("pointer_down", x=400, y=300)
    world.send("pointer_up", x=400, y=300)
    assert world.settle() == 0  # a hand on the wheel stops it
    assert world.controls.camera != start


def test_another_exaggeration_lifts_the_camera():
    world = World(ROTATED, OrbitControls, height=100.0)
    higher = Ground(ROTATED, lambda x, y: LEVEL, world.pick, 5.0)
    world.controls.stand_on(higher)
    assert world.controls.camera.z == pytest.approx(5 * LEVEL + higher.clearance)


def hill(x, y):
    return 500.0 + 0.05 * (x - 500000.0)


@pytest.mark.parametrize(("keys", "pitch"), [("w", -60.0), ("w", 40.0), ("a", 0.0), ("wE", 0.0)])
def test_walking_stays_on_the_ground(keys, pitch):
    ground = Ground(ROTATED, hill, lambda column, row: None, EXAGGERATION)
    x, y = (float(v) for v in ROTATED.to_crs(2000.0, 4000.0))
    controls = WalkControls(Camera(x, y, 9000.0, heading=90.0, pitch=pitch), ground, SIZE, RATIO)
    assert controls.camera.z == pytest.approx(EXAGGERATION * hill(x, y) + 1.7)
    for key in keys:
        controls.handle({"event_type": "key_down", "key": key})
    for _ in range(120):
        controls.advance(1 / 60)
        assert controls.camera.z == pytest.approx(EXAGGERATION * hill(controls.camera.x, controls.camera.y) + 1.7)
    walked = math.hypot(controls.camera.x - x, controls.camera.y - y)
    # two seconds at half a spacing a second and the time to get going; looking up or down does not slow it
    assert 0.5 * ROTATED.spacing * 1.5 < walked < 0.5 * ROTATED.spacing * 2.1
    controls.handle({"event_type": "pointer_down", "x": 100, "y": 100, "button": 1, "modifiers": ()})
    controls.handle({"event_type": "pointer_move", "x": 180, "y": 100})
    assert controls.camera.heading == pytest.approx(90 + 80 * 120 / 600)
