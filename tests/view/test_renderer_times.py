"""Times of frames."""

import numpy as np

from oracle.landscapes import hills
from orogen.gpu import Gpu
from orogen.terrain import open_terrain


def test_frames_of_a_flight_are_timed(gpu: Gpu) -> None:
    with open_terrain(hills(60, 300.0).astype(np.float32), spacing=30.0, algorithm="udlod") as terrain:
        camera = terrain.camera()
        cameras = [camera.moved(heading=camera.heading + k) for k in range(3)]
        timings = terrain.renderer.time_frames(cameras, (64, 48))
        assert len(timings) == 3
        for timing in timings:
            assert timing.record_time > 0
            if "timestamp-query" in terrain.renderer.gpu.features:
                assert {"refine", "shade"} <= set(timing.gpu_times)
        # and what is drawn afterwards is timed again
        assert set(terrain.render(camera, (64, 48), samples=1).gpu_times) == set(timings[0].gpu_times)
