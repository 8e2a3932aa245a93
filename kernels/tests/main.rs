//! Integration tests, by module of the crate.

mod common;

mod mesh {
    mod connectivity;
}
mod collapse {
    mod engine;
    mod rounds;
}
mod quadric {
    mod independent_collapses;
}
mod fitting {
    mod fit;
}
mod jia01 {
    mod simplify;
}
mod certify {
    mod proof;
}
mod certified {
    mod history;
    mod tracked;
}
mod seams {
    mod simplify;
}
mod planar {
    mod simplify;
}
mod refinement {
    mod steps;
}
mod normal {
    mod locking;
    mod remesh;
}
mod snm {
    mod container;
}
