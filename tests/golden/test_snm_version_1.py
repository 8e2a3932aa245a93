"""Files in version 1 of the format decode to the same levels in all later versions."""

from __future__ import annotations

import base64
import hashlib

import pytest

from scanloom.stages.normal_meshes.normal_mesh import decode

LINEAR = (
    "c25tAXrMQu08TNETO7ONV1qDgofze95kaGG9jOnZ2J+Ip5OufGR+ThKsfjS55w5fnqdjz5f+Ja2mR2Dy2FH5BEqqcifhRRi7"
    "vMLlpF9ewgjKtbMOMyjaZdAlK1sBAQx5lrVdkRgB8traQH5QscXR9JvdI44ZXTujGmLsNasOpavXXBCqAFWtnisrXBd7fh6Y"
    "zphRNFyw8A9/PbXs1APf7+c+hcPW26lLlja5UNe49ml+asgv0yfOXzcTViL3grk2jkyiE8WkkRcIwHRGexFsDVu9BOpUOsgh"
    "WEEpH0kxR1eIAcQZJlyjd92WNF5+ywlRpDdZ1Pz8r6TvRqJBFKKuvGoXRTxiLY4JNMnCyUlxb7wyIzeWWCIK2V9L3OAkev7J"
    "SPzZTsFz1VPvDP2Z2gOhTchVE4Ccwd7xb2Itq+tK1slSiLZFeyCP7YWqsAVIOEnzUq4uXQXBthPzxrTzq29tyKlZlSWsNqKG"
    "f3s4Sg=="
)
LINEAR_READS = "00e4a56cb95cea4032970375bbb027e063c1249f4a4fe9d813ed3402ab4785e0"

BUTTERFLY = (
    "c25tAXTXem08TNETPDONV1qDgofzNRL6TNwq0Qqcb8dVZPpbQ/5d0Ih+cLGRWTwjiY1aV8CS2hxWdKIlbQaAIGRbdmCMb6rL"
    "ZuhG/BluJy5N3bZ2wA8npZdVPqM27Jp9udlCVfFyd4mKWfzPe5TmZ7zstyI3Z1ZTCuyiYXaKAXzk2U9r30QvgIzxibhjVJEZ"
    "imGZxy8MjnYRgxQTbjAuq78JQBXKa+FAJ5ZCLT393+sW1/KVqfaDzDIEO+lq3gBO6uzpWx7o2Vl+VHdKPbs4G92raJmKrxOD"
    "nf+JchpsH5MB0sB1gs8hws72oIEWT83yFRqBlmdjW+gLRbiTpnGCXlytXT5+P5gafbNZY4wdNP0WO4Q/XMiBRRitrqTKEH5E"
    "YIbhFmmss6u/7PdshFQlsfUzTtSViBgMZj5pWtxCuz2cTJ9VPiraIeZ5xdag5D5d75Mta2KJxdCNZefp3c8IrjwWk/7/xxWd"
    "Y44wx3+toFUfmFh2dCU="
)
BUTTERFLY_READS = "227c63b417c5fdbdce2110800fbac751e5b83f4be90f751cd4f135883cf6663c"


@pytest.mark.parametrize(("file", "reads"), [(LINEAR, LINEAR_READS), (BUTTERFLY, BUTTERFLY_READS)])
def test_a_version_1_file_decodes_as_before(file: str, reads: str) -> None:
    """Compare every bit of every level of a sheet with holes, boundaries, colours and exceptions."""
    found = decode(base64.b64decode(file))
    digest = hashlib.sha256()
    for level in found.levels:
        digest.update(level.vertices.tobytes() + level.triangles.tobytes() + level.colors.tobytes())
    assert len(found.levels) == 3
    assert digest.hexdigest() == reads
