"""Shows that Mesa's llvmpipe frees a fence whose lock one of its own raster threads still holds.

    python tools/driver_race.py [RUNS] [FRAMES]

A plain wgpu program (no Orogen) draws small pictures in processes of its own. A preloaded library lets raster threads
sleep for up to a millisecond before they wake whoever waits for a fence, which no correct program minds, and counts
mutexes that are destroyed while they are held. Every other run waits for those, as the driver should: it has to finish.
Linux with a C compiler; docs/reliability.md has the result.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static int patient;

__attribute__((constructor)) static void begin(void) { patient = getenv("PATIENT") != NULL; }

int pthread_cond_broadcast(pthread_cond_t *condition) {
  static int (*real)(pthread_cond_t *);
  static __thread int raster = -1;
  if (!real) real = dlvsym(RTLD_NEXT, "pthread_cond_broadcast", "GLIBC_2.3.2");
  if (raster < 0) {
    char name[32] = "";
    pthread_getname_np(pthread_self(), name, sizeof name);
    raster = !strncmp(name, "llvmpipe", 8);
  }
  if (raster) usleep(200 + rand() % 800);
  return real(condition);
}

int pthread_mutex_destroy(pthread_mutex_t *mutex) {
  static int (*real)(pthread_mutex_t *);
  if (!real) real = dlsym(RTLD_NEXT, "pthread_mutex_destroy");
  int held = pthread_mutex_trylock(mutex) != 0;
  if (held) {
    Dl_info caller;
    if (dladdr(__builtin_return_address(0), &caller)) fprintf(stderr, "HELD %s\n", caller.dli_fname);
    if (patient) pthread_mutex_lock(mutex);
  }
  if (!held || patient) pthread_mutex_unlock(mutex);
  return real(mutex);
}
"""

PROGRAM = """
import sys
import wgpu

device = wgpu.gpu.request_adapter_sync().request_device_sync(required_features=["timestamp-query"])
module = device.create_shader_module(code='''
@group(0) @binding(0) var<storage, read_write> data: array<u32>;
@compute @workgroup_size(64) fn step(@builtin(global_invocation_id) at: vec3u) { data[at.x] = data[at.x] * 5u + at.x; }
@vertex fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
  return vec4f(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.5, 1.0);
}
@fragment fn color(@builtin(position) at: vec4f) -> @location(0) vec4f {
  return vec4f(f32(data[u32(at.x)] & 255u) / 255.0);
}
''')
layout = device.create_bind_group_layout(
    entries=[{"binding": 0, "visibility": "COMPUTE|FRAGMENT", "buffer": {"type": "storage"}}]
)
pipelines = device.create_pipeline_layout(bind_group_layouts=[layout])
compute = device.create_compute_pipeline(layout=pipelines, compute={"module": module, "entry_point": "step"})
render = device.create_render_pipeline(
    layout=pipelines, vertex={"module": module, "entry_point": "corner"},
    fragment={"module": module, "entry_point": "color", "targets": [{"format": "rgba8unorm"}]},
)
data = device.create_buffer(size=16384, usage="STORAGE|COPY_SRC")
back = device.create_buffer(size=16384, usage="MAP_READ|COPY_DST")
stamps = device.create_query_set(type="timestamp", count=10)
for frame in range(int(sys.argv[1])):
    if frame % 20 == 0:
        size = 32 + frame * 7 % 97
        view = device.create_texture(size=(size, size, 1), format="rgba8unorm", usage="RENDER_ATTACHMENT").create_view()
    group = device.create_bind_group(layout=layout, entries=[{"binding": 0, "resource": {"buffer": data}}])
    encoder = device.create_command_encoder()
    for number in range(5):
        timed = {"query_set": stamps, "beginning_of_pass_write_index": 2 * number,
                 "end_of_pass_write_index": 2 * number + 1}
        if number < 3:
            run = encoder.begin_compute_pass(timestamp_writes=timed)
            run.set_pipeline(compute)
        else:
            target = {"view": view, "load_op": "clear", "store_op": "store"}
            run = encoder.begin_render_pass(color_attachments=[target], timestamp_writes=timed)
            run.set_pipeline(render)
        run.set_bind_group(0, group)
        run.dispatch_workgroups(64) if number < 3 else run.draw(3)
        run.end()
    encoder.copy_buffer_to_buffer(data, 0, back, 0, 4096)
    device.queue.submit([encoder.finish()])
    back.map_sync("READ")
    back.unmap()
"""


def main(runs: int = 6, frames: int = 3000) -> None:
    """Print a line per run."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder) / "shim.c", Path(folder) / "shim.so"
        source.write_text(SHIM, encoding="utf-8")
        subprocess.run(["cc", "-O1", "-shared", "-fPIC", source, "-o", library, "-ldl"], check=True)
        for run in range(runs):
            patient = {"PATIENT": "1"} if run % 2 else {}
            env = {**os.environ, **patient, "LD_PRELOAD": str(library)}
            done = subprocess.run([sys.executable, "-c", PROGRAM, str(frames)], env=env, capture_output=True, text=True)
            held = [line.split()[1] for line in done.stderr.splitlines() if line.startswith("HELD ")]
            end = "finished" if done.returncode == 0 else f"ended by signal {-done.returncode}"
            how = "waits for held mutexes" if patient else "destroys held mutexes"
            names = ", ".join(sorted({Path(name).name for name in held}))
            sys.stdout.write(f"{frames} frames, {how}: {end}; destroyed while held: {len(held)} {names}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
