"""Parts of `bake`: the atlas, the pixels under its triangles, the colours there, and what fills the gaps."""
