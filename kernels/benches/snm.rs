//! Encoding and decoding of normal mesh files; elements are triangles of the original surface.

use std::rc::Rc;

use criterion::Criterion;
use scanloom_kernels::normal::decode::decode;
use scanloom_kernels::snm::{Reader, Writer};

use crate::common::{measure, plain_field};
use crate::normal::{LEVELS, remeshed};

pub fn bench(criterion: &mut Criterion) {
    let whole = |size| {
        let mesh = remeshed(plain_field(size));
        let (_, header, base) = Reader::new(&mesh.file).expect("just written");
        Rc::new((mesh, header, base))
    };
    measure(criterion, "snm/encode", whole, |whole| {
        let (mesh, header, base) = &*whole;
        let mut writer = Writer::new(header, base).expect("in its order");
        for (level, step) in mesh.levels.iter().zip(&mesh.steps) {
            writer.write_level(&level.topology, &[], &step.refinement).expect("of the level before");
        }
        writer.finish()
    });
    measure(criterion, "snm/decode", whole, |whole| decode(&whole.0.file, LEVELS.into()).expect("whole"));
}
