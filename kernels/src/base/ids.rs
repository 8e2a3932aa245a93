//! Typed indices, so that a vertex index cannot be passed as an edge index.

macro_rules! id {
    ($name:ident, $what:literal) => {
        #[doc = concat!("Index of ", $what, ".")]
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
        #[repr(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// Marker for a missing element: across a boundary edge, or removed by a collapse.
            pub const NONE: Self = Self(u32::MAX);

            #[inline]
            pub fn from_index(index: usize) -> Self {
                Self(index as u32)
            }

            #[inline]
            pub fn index(self) -> usize {
                self.0 as usize
            }

            #[inline]
            pub fn is_none(self) -> bool {
                self == Self::NONE
            }

            #[inline]
            pub fn is_some(self) -> bool {
                self != Self::NONE
            }
        }
    };
}

id!(VertexId, "a vertex");
id!(HalfedgeId, "a halfedge: 3 × its triangle + its corner");
id!(EdgeId, "an edge");
id!(TriangleId, "a triangle");
