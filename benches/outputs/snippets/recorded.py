"""Replay a record in memory and from file: recorded.py MESH METHOD NAME=NUMBER ...."""

import sys

import numpy as np

from scanloom import UsageError, load_record, read_mesh, simplify, write_mesh

path, method, *options = sys.argv[1:]
numbers = {name: float(number) for name, number in (option.split("=") for option in options)}
light = simplify(read_mesh(path), method=method, record=True, **numbers)
light.record.save("record.npz")
loaded = load_record("record.npz")
before, after = len(light.record.mesh.triangles), len(light.mesh.triangles)
for share in (0, 0.01, 0.3, 0.7, 1):
    wanted = round(before + share * (after - before))
    for fit in (False, True):
        name = f"{share}_{'fitted' if fit else 'plain'}"
        try:
            replayed = loaded.replay(triangles=wanted, fit=fit)
        except UsageError as error:
            print(f"{name}: {error}")
            continue
        print(name, len(replayed.mesh.triangles), replayed.collapses)
        write_mesh(f"{name}.ply", replayed.mesh)
        np.savez(f"{name}.npz", vertex=replayed.vertex_source, triangle=replayed.triangle_source)
    in_memory = light.record.replay(triangles=wanted).mesh
    assert np.array_equal(in_memory.vertices, loaded.replay(triangles=wanted).mesh.vertices)
try:
    loaded.replay(triangles=1)
except UsageError as error:
    print(error)
