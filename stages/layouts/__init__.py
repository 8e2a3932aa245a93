"""Readers for scan folders: one module a layout, `LAYOUTS` the table of them."""

from stages.layouts.layout import Layout
from stages.layouts.params import ScanParams
from stages.layouts.read import read_scan, recognise, require_complete
from stages.layouts.scan_json import write_scan_json
from stages.layouts.table import LAYOUTS

__all__ = ["LAYOUTS", "Layout", "ScanParams", "read_scan", "recognise", "require_complete", "write_scan_json"]
