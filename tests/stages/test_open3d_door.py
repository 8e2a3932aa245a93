"""Open3D must import on a machine without the system's libusb, and explain what else is missing."""

import subprocess
import sys

import pytest

from scanloom.stages._open3d import _explain

HIDE_SYSTEM_LIBUSB = """
import ctypes
real = ctypes.CDLL.__init__
def init(self, name, *args, **kwargs):
    if name == "libusb-1.0.so.0":
        raise OSError("libusb-1.0.so.0: cannot open shared object file")
    if name is not None and str(name).endswith(".so") and "libusb" in str(name):
        print("packaged libusb loaded")
    real(self, name, *args, **kwargs)
ctypes.CDLL.__init__ = init
from scanloom.stages._open3d import import_open3d
mesh = import_open3d().t.geometry.TriangleMesh.create_sphere()
print(mesh.vertex.positions.shape[0])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Open3D's Linux wheel wants libusb from the system")
def test_imports_without_system_libusb():
    result = subprocess.run(
        [sys.executable, "-P", "-c", HIDE_SYSTEM_LIBUSB]
        if sys.version_info >= (3, 11)
        else [sys.executable, "-c", HIDE_SYSTEM_LIBUSB],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "packaged libusb loaded" in result.stdout


PLOT = """
import sys
from scanloom.stages._open3d import import_open3d
plots = sys.modules[import_open3d().visualization.draw_plotly.__module__]
assert "dash" not in sys.modules
page = plots.html.Div(children=[plots.dcc.Graph(figure={})])
server = plots.Dash("plots")
server.layout = page
import dash
assert isinstance(server, dash.Dash) and isinstance(page, dash.html.Div)
print(type(page.children[0]) is dash.dcc.Graph)
"""


@pytest.mark.slow
def test_dash_is_imported_where_a_plot_uses_it():
    result = subprocess.run([sys.executable, "-c", PLOT], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout.strip()) == (0, "True"), result.stderr


def test_missing_library_is_named_with_its_package():
    message = _explain("libEGL.so.1: cannot open shared object file: No such file or directory")
    assert "libEGL.so.1" in message
    assert "apt-get install libegl1" in message
