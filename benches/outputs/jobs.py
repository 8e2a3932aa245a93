"""Jobs of same_outputs.py: command lines of scanloom, and Python snippets.

A step begins with a command of scanloom, or with the name of a file in snippets/. It runs in the folder of
its job. Placeholders in a step:

    {data}      the real scans and meshes
    {samples}   the sample scans of the first checkout
    {inputs}    generated inputs, see inputs.py
    {first}     outputs of the same job by the first checkout, which the second one has to read
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Job:
    """Command lines that run in one folder.

    Attributes
    ----------
    steps : command lines without the program's name.
    """

    name: str
    steps: tuple[str, ...]


@dataclass(frozen=True)
class TestMesh:
    """Mesh for which all methods run; `shape` is a bound in metres."""

    path: str
    shape: float
    is_colored: bool = False


MODELS = {
    "horse": TestMesh("horse.ply", 0.001),
    "camelhead": TestMesh("camelhead.off", 0.005),
    "spot": TestMesh("spot/spot_triangulated.obj", 0.02),
    "fuze": TestMesh("fuze/fuze.obj", 0.002),
    "duck": TestMesh("Duck.glb", 0.02),
    "airplane": TestMesh("colored_airplane.ply", 0.01, is_colored=True),
}
KITCHEN = "{data}/meshes/redkitchen_fused_vertexcolor.ply"

# Jobs of --quick: some of each kind.
QUICK_PATTERNS = (
    "run/rgbd",
    "stages/*",
    "methods/spot/*",
    "methods/airplane/*",
    "controlled/*",
    "records/*",
    "normal_meshes/camelhead*",
    "textures/duck",
    "measures/spot*",
    "pictures/spot",
    "scans/samples*",
    "recordings/realsense.bag",
    "formats/Duck.glb",
    "broken/*.obj",
    "words/*",
)


def list_jobs(data: Path) -> list[Job]:
    """List all jobs, those on small inputs first.

    Parameters
    ----------
    data : its file names determine some of the jobs.
    """
    return [
        *_make_message_jobs(),
        *_make_method_jobs(),
        *_make_region_jobs(),
        *_make_record_jobs(),
        *_make_normal_mesh_jobs(),
        *_make_texture_jobs(),
        *_make_measurement_jobs(),
        *_make_rendering_jobs(),
        *_make_cleaning_jobs(data),
        *_make_format_jobs(data),
        *_make_damaged_file_jobs(data),
        *_make_recording_jobs(),
        *_make_scan_jobs(data),
        *_make_stage_jobs(),
        *_make_kitchen_jobs(),
        *_make_run_jobs(),
    ]


def _get_mesh_path(name: str) -> str:
    return f"{{data}}/meshes/{MODELS[name].path}"


def _make_method_jobs() -> Iterator[Job]:
    """Yield jobs that simplify each model with each method and its parameters."""
    for name, model in MODELS.items():
        shape = f"--max-shape {model.shape}"
        bounds = f"{shape} --max-color 40" if model.is_colored else shape
        options = {
            "quadric": ("--ratio 0.1", "--triangles 500 --set simplify.fit=false"),
            "certified": (
                shape,
                bounds,
                f"--ratio 0.3 {bounds}",
                f"--max-shape {2 * model.shape} --set simplify.certified.tight_bounds=true --save-bounds "
                "bounds.ply",
            ),
            "seams": (
                "--ratio 0.1",
                "--ratio 0.1 --set simplify.threads=1",
                "--ratio 0.02 --set simplify.fit=false",
                "--ratio 0.1 --set simplify.seams.max_seam_drift=0.002",
                "--ratio 0.3 --set simplify.seams.texture_weight=2 --set simplify.seams.normal_weight=0.2 "
                "--set simplify.seams.shape_weight=0.5 --set simplify.seams.valence_penalty=1 "
                "--set simplify.seams.duplicate_penalty=1 --set simplify.seams.material_border_penalty=1 "
                "--set "
                "simplify.seams.part_border_penalty=1",
                f"--ratio 0.1 --set simplify.seams.similar_distance={model.shape / 4}",
            ),
            "jia01": (
                "",
                bounds,
                "--ratio 0.3",
                f"{bounds} --set simplify.jia01.paper_rule=true",
                f"--set simplify.jia01.resolution={8 * model.shape}",
            ),
            "planar": (
                "",
                bounds,
                f"{shape} --set simplify.planar.patch_angle=20 --set simplify.planar.crease_angle=30 --set "
                "simplify.planar.noise_angle=0",
            ),
            "auto": ("", "--ratio 0.25", "--triangles 800", bounds),
        }
        for method, variants in options.items():
            # Only GLB stores the texture coordinates that seams keeps.
            ending = "glb" if method == "seams" else "ply"
            yield Job(
                f"methods/{name}/{method}",
                tuple(
                    f"simplify {_get_mesh_path(name)} {n}.{ending} --method {method} {variant} --json"
                    for n, variant in enumerate(variants)
                ),
            )


def _make_region_jobs() -> Iterator[Job]:
    """Yield jobs that simplify with regions, locks and importance, by command and API."""
    sphere = '--region "sphere 0 0.3 0.3 0.3 20"'
    box = '--region "box -9 -9 -9 9 0 9 lock"'
    for method, options in {
        "quadric": "--ratio 0.2",
        "seams": "--ratio 0.2",
        "certified": "--max-shape 0.02",
        "jia01": "--ratio 0.4",
        "planar": "--max-shape 0.02",
    }.items():
        named = options.replace("--", "").replace("-", "_").replace(" ", "=")
        yield Job(
            f"controlled/{method}",
            (
                f"simplify {_get_mesh_path('spot')} sphere.ply --method {method} {options} {sphere} --json",
                f"simplify {_get_mesh_path('spot')} box.ply --method {method} {options} {box} --json",
                f"simplify {_get_mesh_path('airplane')} both.ply --method {method} {options} {sphere} "
                f"{box} --json",
                f"controlled.py {_get_mesh_path('spot')} {method} {named}",
            ),
        )


def _make_record_jobs() -> Iterator[Job]:
    """Yield jobs that record a simplification with each method and replay the record.

    The record of the first checkout is also replayed by the second.
    """
    for name, method, options in (
        ("camelhead", "quadric", "--ratio 0.05"),
        ("airplane", "quadric", "--ratio 0.1"),
        ("airplane", "certified", "--max-shape 0.01 --max-color 40"),
        ("airplane", "jia01", "--ratio 0.3"),
        ("spot", "seams", "--ratio 0.05"),
        ("duck", "seams", "--ratio 0.05"),
        ("airplane", "seams", "--ratio 0.05"),
    ):
        yield Job(
            f"records/{name}/{method}",
            (
                f"simplify {_get_mesh_path(name)} light.ply --method {method} {options} --json "
                "--save-record record.npz",
                "mesh replay record.npz half.ply --ratio 0.5 --json",
                "mesh replay record.npz count.glb --triangles 3000 --json",
                "mesh replay record.npz early.ply --set replay.collapses=100 --json",
                "mesh replay record.npz none.ply --set replay.collapses=0 --json",
                "mesh replay record.npz fitted.ply --ratio 0.4 --set replay.fit=true --json",
                "mesh replay record.npz beyond.ply --triangles 10 --json",
                "mesh replay {first}/record.npz of_first.ply --ratio 0.4 --json",
                "cut.py record.npz 0.7 cut.npz",
                "mesh replay cut.npz cut.ply --ratio 0.5 --json",
            ),
        )
    yield Job(
        "records/none",
        (
            f"simplify {_get_mesh_path('spot')} light.ply --method planar --save-record record.npz --json",
            "mesh replay record.npz half.ply --ratio 0.5 --json",
        ),
    )
    yield Job("records/api/quadric", (f"recorded.py {_get_mesh_path('airplane')} quadric ratio=0.1",))
    yield Job("records/api/seams", (f"recorded.py {_get_mesh_path('duck')} seams ratio=0.1",))
    yield Job("records/api/jia01", (f"recorded.py {_get_mesh_path('airplane')} jia01 ratio=0.3",))
    yield Job(
        "records/api/certified", (f"recorded.py {_get_mesh_path('airplane')} certified max_shape=0.01",)
    )


def _make_normal_mesh_jobs() -> Iterator[Job]:
    """Yield jobs on normal meshes: encoding, all levels, and truncated files."""
    for name, path, options in (
        ("horse", _get_mesh_path("horse"), ""),
        (
            "camelhead",
            _get_mesh_path("camelhead"),
            "--set remesh.scheme=butterfly --set remesh.tolerance=1e-4",
        ),
        (
            "camelhead_base",
            _get_mesh_path("camelhead"),
            "--base-triangles 300 --levels 2 --set remesh.relaxations=0",
        ),
        (
            "camelhead_error",
            _get_mesh_path("camelhead"),
            "--set remesh.base_error=0.01 --set remesh.max_error=0.002",
        ),
        ("airplane", _get_mesh_path("airplane"), "--set remesh.color_tolerance=4"),
        ("airplane_coder", _get_mesh_path("airplane"), "--levels 0"),
        ("cow", "{data}/meshes/cow.obj", ""),
        ("spot", _get_mesh_path("spot"), ""),
        ("scan", "{data}/meshes/sceaux_mvs_scene_mesh.ply", "--set remesh.tolerance=1e-3"),
    ):
        yield Job(
            f"normal_meshes/{name}",
            (
                f"mesh remesh {path} normal.ply --save normal.snm --save-levels levels {options} --json",
                "mesh decode normal.snm finest.ply --save-levels decoded --json",
                *(f"mesh decode normal.snm {level}.ply --level {level} --json" for level in (0, 1, 9)),
                "mesh decode {first}/normal.snm of_first.ply --json",
                "cut.py normal.snm 0.6 cut.snm",
                "mesh decode cut.snm cut.ply --json",
                "mesh decode cut.snm cut_4.ply --level 4",
            ),
        )


def _make_texture_jobs() -> Iterator[Job]:
    """Yield jobs that simplify meshes and bake textures."""
    for name in ("duck", "airplane", "fuze"):
        original = _get_mesh_path(name)
        yield Job(
            f"textures/{name}",
            (
                f"simplify {original} light.ply --method quadric --ratio 0.1 --json",
                f"mesh bake light.ply {original} baked.glb --json",
                f"mesh bake light.ply {original} small.obj --set bake.max_size=256 --set bake.padding=2 "
                "--set bake.samples=3 --json",
                f"mesh bake light.ply {original} fine.ply --set bake.texel_size=0.01 "
                "--set bake.max_size=1024 --json",
                f"simplify {original} baked_at_once.glb --ratio 0.2 --bake --json",
            ),
        )


def _make_measurement_jobs() -> Iterator[Job]:
    """Yield jobs that compare, certify, and find planar patches."""
    for name, model in MODELS.items():
        original = _get_mesh_path(name)
        max_color = "--max-color 60" if model.is_colored else ""
        patch_color = "--set patches.max_color=20" if model.is_colored else ""
        yield Job(
            f"measures/{name}",
            (
                f"simplify {original} light.ply --method quadric --ratio 0.2 --json",
                f"compare {original} light.ply --json",
                f"compare {original} light.ply --set compare.samples=20000 --set compare.seed=7 --json",
                f"mesh certify light.ply {original} --json --save-bounds bounds.ply",
                f"mesh certify light.ply {original} --max-shape {model.shape} {max_color} --json",
                f"mesh certify light.ply {original} --set certify.effort=1 --set "
                "certify.shape_tolerance=0.2 --json",
                f"mesh patches {original} patches.ply --json",
                f"mesh patches {original} thin.ply --max-shape {model.shape / 4} {patch_color} --json "
                "--set patches.patch_angle=15 --set patches.crease_angle=15 --set patches.noise_angle=0",
                f"measured.py {original}",
            ),
        )
    for name in ("fandisk.obj", "rocker-arm.obj", "face.obj"):
        yield Job(f"measures/{name}", (f"mesh patches {{data}}/meshes/{name} patches.ply --json",))


def _make_rendering_jobs() -> Iterator[Job]:
    """Yield jobs that render textured, coloured and plain meshes."""
    for name in MODELS:
        yield Job(
            f"pictures/{name}",
            tuple(
                f"render {_get_mesh_path(name)} {shading}.png --shading {shading} --viewpoint {view} "
                "--width 640 "
                "--json"
                for shading, view in (("color", 1), ("plain", 2), ("edges", 3))
            ),
        )


def _make_cleaning_jobs(data: Path) -> Iterator[Job]:
    """Yield jobs that clean each mesh, and two meshes with each option."""
    for path in _find_mesh_files(data):
        yield Job(f"cleaning/{path.name}", (f"clean '{{data}}/{path}' clean.ply --json",))
    for name, path in {
        "scan": "{data}/meshes/sceaux_mvs_scene_mesh.ply",
        "truck": "{data}/meshes/CesiumMilkTruck.glb",
    }.items():
        yield Job(
            f"cleaning/options/{name}",
            (
                f"clean {path} filled.ply --fill-holes 1 --json",
                f"clean {path} all.ply --min-island-area 0 --json",
                f"clean {path} one.obj --keep-largest --json",
                f"clean {path} apart.glb --set clean.stitch=false --json",
                f"clean {path} welded.ply --set clean.weld_distance=0.02 --json",
            ),
        )


def _make_format_jobs(data: Path) -> Iterator[Job]:
    """Yield jobs that write each mesh in all formats and read it back."""
    for path in _find_mesh_files(data):
        yield Job(f"formats/{path.name}", (f"formats.py '{{data}}/{path}'",))


def _make_damaged_file_jobs(data: Path) -> Iterator[Job]:
    """Yield jobs that read damaged files; the result is an error, or a mesh if the file can be repaired."""
    for path in sorted((data / "broken").iterdir()):
        yield Job(
            f"broken/{path.name}",
            (
                f"clean '{{data}}/broken/{path.name}' clean.ply",
                f"simplify '{{data}}/broken/{path.name}' light.glb --method seams --ratio 0.5 --json",
            ),
        )


def _find_mesh_files(data: Path) -> list[Path]:
    folder = data / "meshes"
    known = {".ply", ".obj", ".off", ".stl", ".glb", ".gltf"}
    return sorted(path.relative_to(data) for path in folder.rglob("*") if path.suffix in known)


def _make_recording_jobs() -> Iterator[Job]:
    """Yield jobs that read recordings in every format, complete and truncated."""
    whole = ("realsense.bag", "realsense_raw.db3", "realsense_png.db3", "realsense_zstd.db3")
    whole += ("ros1_none.bag", "ros1_bz2.bag", "ros1_lz4.bag", "ros1_png.bag")
    whole += ("ros2.db3", "ros2_zstd.db3", "ros2.mcap", "ros2_zstd.mcap")
    for name in whole:
        yield Job(
            f"recordings/{name}",
            (
                f"inspect {{inputs}}/{name} --json",
                f"fuse {{inputs}}/{name} one.ply --set scan.first=2 --set scan.last=2 --voxel-size 0.01 "
                "--json",
            ),
        )
    for name in ("realsense.bag", "ros2.db3", "ros2.mcap"):
        yield Job(
            f"recordings/cut_{name}",
            tuple(f"inspect {{inputs}}/cut_{cut}_{name} --json" for cut in (0.02, 0.5, 0.9, 0.999)),
        )


def _make_scan_jobs(data: Path) -> Iterator[Job]:
    """Yield jobs that inspect each scan folder."""
    for sample in ("rgbd", "stereo"):
        scan = f"{{samples}}/{sample}"
        yield Job(
            f"scans/samples/{sample}",
            (
                f"inspect {scan} --json",
                f"inspect {scan} --picture picture.png",
                f"inspect {scan} --set scan.first=3 --set scan.last=9 --every 2 --json",
                f"frames.py {scan} 3",
            ),
        )
    for kind in ("rgbd", "stereo", "real"):
        for folder in sorted((data / kind).iterdir()):
            yield Job(f"scans/{kind}/{folder.name}", (f"inspect {{data}}/{kind}/{folder.name} --json",))
    yield Job("scans/rgbd/open3d/RGBD", ("inspect {data}/rgbd/open3d_testdata/RGBD --json",))
    rig = "{data}/stereo/opencv_chessboard_rig"
    calibrations = sorted((data / "real" / "calibrations").iterdir())
    yield Job(
        "scans/calibrations",
        tuple(
            f"inspect {rig} --set scan.calibration={{data}}/real/calibrations/{path.name} --json"
            for path in calibrations
        ),
    )
    cones = "{data}/stereo/middlebury2003_cones"
    cabinet = "{data}/real/freiburg3_cabinet_keyframes"
    yield Job(
        "scans/stated",
        (
            f"inspect {cones} --intrinsics 500,500,225,187 --set scan.baseline=0.16 --json",
            f"inspect {cones} --intrinsics 500,500 --json",
            f"inspect {cabinet} --poses {cabinet}/truth_cam_poses.txt --json",
            f"inspect {cabinet} --set scan.depth_scale=1000 --set scan.check_poses=false --json",
            f"inspect {cabinet} --set scan.layout=kitti --json",
            "inspect {data}/real/kitti_stereo_2015 --set scan.first=0 --set scan.last=0 --json",
            "inspect {data}/rgbd/7scenes_redkitchen --every 10 --picture picture.png --json",
        ),
    )


def _make_stage_jobs() -> Iterator[Job]:
    """Yield jobs of single stages that read scans."""
    stereo, rgbd = "{samples}/stereo", "{samples}/rgbd"
    yield Job(
        "stages/depth",
        (
            f"depth {stereo} depth --set scan.last=5 --json",
            "fuse depth fused.ply --json",
            f"depth {stereo} other --every 5 --set depth.matcher=sgbm --set depth.sgbm.left_right=match "
            "--set depth.sgbm.smooth=true --json",
            "fuse other other.glb --voxel-size 0.01 --set fuse.truncation=0.04 --set fuse.min_weight=1 "
            "--set fuse.color=false --json",
        ),
    )
    yield Job(
        "stages/register",
        (
            f"register {rgbd} found --json",
            f"fuse {rgbd} fused.ply --poses found/trajectory.tum --voxel-size 0.01 --json",
            f"fuse {rgbd} some.ply --poses found/trajectory.tum --every 3 --json",
            f"register {rgbd} refined --every 4 --refine --set register.loops=false --json",
        ),
    )
    yield Job("depth/motorcycle", ("depth {data}/stereo/middlebury2014_motorcycle depth --json",))
    yield Job("depth/kitti", ("depth {data}/stereo/kitti_sequence_1 depth --set scan.last=2 --json",))
    yield Job("depth/euroc", ("depth {data}/stereo/euroc_V1_01_easy_static depth --set scan.last=1 --json",))
    one_pair = "--set scan.first=0 --set scan.last=0"
    yield Job("depth/kitti_2015", (f"depth {{data}}/real/kitti_stereo_2015 depth {one_pair} --json",))
    yield Job(
        "depth/temple_ring",
        (
            "depth {data}/stereo/middlebury_templeRing depth --set scan.last=7 --json",
            "fuse depth fused.ply --json",
        ),
    )
    for name, scan, options in (
        ("kitchen", "rgbd/7scenes_redkitchen", "--every 10 --voxel-size 0.03"),
        ("tabletop", "rgbd/tabletop_box_realsense", "--every 5"),
        ("open3d", "rgbd/open3d_testdata/RGBD", "--voxel-size 0.02"),
        ("turntable", "rgbd/turntable_d435_data1", "--set scan.last=0"),
        ("rpy", "real/rgbd_dataset_freiburg1_rpy", "--every 4 --voxel-size 0.02"),
        ("phone", "real/phone_desk_no_calibration", "--set scan.last=0"),
    ):
        yield Job(f"fuse/{name}", (f"fuse {{data}}/{scan} fused.ply {options} --json",))
    few = "--set scan.last=7"
    yield Job("register/desk", (f"register {{data}}/rgbd/realsense_desk_tum_layout found {few} --json",))
    yield Job("register/rpy", (f"register {{data}}/real/rgbd_dataset_freiburg1_rpy found {few} --json",))


def _make_kitchen_jobs() -> Iterator[Job]:
    """Yield jobs on a fused room with colours, holes and islands."""
    yield Job(
        "kitchen/methods",
        (
            f"clean {KITCHEN} clean.ply --json",
            "simplify clean.ply quadric.ply --ratio 0.1 --json",
            "simplify clean.ply certified.ply --max-shape 0.03 --max-color 60 --json",
            "simplify clean.ply seams.ply --method seams --ratio 0.1 --json",
            "simplify clean.ply jia01.ply --json",
            "simplify clean.ply planar.ply --method planar --max-shape 0.02 --json",
            "simplify clean.ply region.ply --ratio 0.1 --region 'sphere 0 0 1.5 0.8 20' --json",
            "mesh patches clean.ply patches.ply --max-shape 0.02 --json",
            "compare clean.ply quadric.ply --set compare.samples=200000 --json",
            "mesh certify certified.ply clean.ply --max-shape 0.03 --json",
            "mesh bake quadric.ply clean.ply baked.glb --set bake.max_size=1024 --json",
        ),
    )
    yield Job(
        "kitchen/as_it_is",
        (
            f"simplify {KITCHEN} seams.ply --method seams --ratio 0.1 --json",
            f"simplify {KITCHEN} planar.ply --method planar --json",
            f"simplify {KITCHEN} quadric.ply --ratio 0.1 --json",
            f"render {KITCHEN} kitchen.png --width 640 --scan {{data}}/rgbd/7scenes_redkitchen --json",
        ),
    )


def _make_run_jobs() -> Iterator[Job]:
    """Yield jobs of complete runs.

    A second run in the same folder reports the stages that it repeats and the reasons.
    """
    everything = "--set bake.enabled=true --set remesh.enabled=true"
    yield Job("run/stereo", (f"run {{samples}}/stereo -o out {everything} --json",))
    yield Job(
        "run/rgbd",
        (
            f"run {{samples}}/rgbd -o out {everything} --json",
            "run {samples}/rgbd -o out --set simplify.max_shape=0.01 --set simplify.max_color=60 "
            "--set bake.enabled=true --json",
            "run {samples}/rgbd -o out --until clean",
            "cache verify out",
        ),
    )
    yield Job("run/registered", ("run {samples}/rgbd -o out --every 3 --set register.enabled=true --json",))
    yield Job("run/parameters", ("run {samples}/rgbd -o out --every 3 --config {inputs}/run.toml",))
    yield Job(
        "run/real",
        ("run {data}/real/rgbd_dataset_freiburg1_rpy -o out --every 4 --set fuse.voxel_size=0.02 --json",),
    )


def _make_message_jobs() -> Iterator[Job]:
    """Yield jobs whose output is text for people: without --json, and usage errors."""
    spot, duck = _get_mesh_path("spot"), _get_mesh_path("duck")
    yield Job(
        "words/text",
        (
            f"simplify {spot} quadric.ply --method quadric --ratio 0.1",
            f"simplify {spot} certified.ply --max-shape 0.02",
            f"simplify {duck} seams.glb --ratio 0.1",
            f"simplify {spot} jia01.ply --method jia01",
            f"simplify {spot} planar.ply --method planar",
            f"mesh patches {spot} patches.ply",
            f"compare {spot} quadric.ply --set compare.samples=1000",
            f"mesh certify quadric.ply {spot}",
            f"clean {spot} clean.ply",
            f"mesh remesh {spot} remeshed.ply",
            f"render {spot} spot.png --width 64",
            "inspect {samples}/rgbd",
            "inspect {samples}/stereo",
            "depth {samples}/stereo depth --set scan.last=0",
        ),
    )
    yield Job("words/config", ("config",))
    yield Job(
        "words/wrong",
        (
            "",
            "simplify",
            f"simplify {spot} light.xyz --ratio 0.1",
            "simplify missing.ply light.ply --ratio 0.1",
            f"simplify {spot} light.ply --ratio 2 --json",
            f"simplify {spot} light.ply --ratio 0.1 --triangles 5 --json",
            f"simplify {spot} light.ply --ratio 0.1 --method planar --json",
            f"simplify {spot} light.ply --ratio 0.1 --max-shape 0.01 --method quadric --json",
            f"simplify {spot} light.ply --ratio 0.1 --max-shape 0.01 --method seams --json",
            f"simplify {spot} light.ply --method fastest",
            f"simplify {spot} light.ply --unheard-of",
            f"simplify {spot} light.ply --max-color 20 --method certified --json",
            f"simplify {spot} light.ply --ratio 0.1 --region 'cone 1 2 3' --json",
            f"simplify {spot} light.ply --ratio 0.1 --region 'sphere 9 9 9 1 lock' --json",
            f"simplify {spot} light.ply --method planar --save-bounds bounds.ply --json",
            f"simplify {spot} light.stl --ratio 0.1 --bake --json",
            f"simplify {spot} light.glb --ratio 0.1 --bake --json",
            "simplify {data}/meshes/cow.obj light.ply --method quadric --ratio 0.1 --json",
            f"mesh remesh {spot} out.ply --levels 99",
            "mesh remesh {data}/meshes/pirate.obj out.ply --json",
            f"mesh decode {spot} out.ply --json",
            f"mesh replay {spot} out.ply --ratio 0.5 --json",
            f"bake {spot} {{data}}/meshes/cow.obj out.glb --json",
            f"render {spot} out.jpg",
            f"render {spot} out.png --viewpoint 20",
            f"compare {spot} {{data}}/broken/empty.obj --json",
            "inspect missing --json",
            "fuse {samples}/stereo out.ply --json",
            "run {samples}/rgbd -o out --set fuse.voxel=1",
            "run {samples}/rgbd -o out --set fuse.voxel_size=-1",
            "run {samples}/rgbd -o out --until nothing",
        ),
    )
    alone = {
        "quadric": "--set simplify.fit=true",
        "certified": "--set simplify.certified.tight_bounds=true",
        "jia01": "--set simplify.jia01.paper_rule=true",
        "seams": "--set simplify.seams.texture_weight=1",
        "planar": "--set simplify.planar.patch_angle=30",
    }
    for method in alone:
        others = (option for other, option in alone.items() if other != method)
        yield Job(
            f"words/not_for_{method}",
            tuple(f"simplify {spot} light.ply --method {method} {option} --json" for option in others),
        )
