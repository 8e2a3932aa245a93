//! Inner loops in the widest instructions that the processor has.

/// A function that is compiled twice, and called in the version that the processor has instructions for. The results are
/// the same to the bit: of whole numbers anyway, and of others because each product, sum and quotient is rounded by itself.
macro_rules! by_processor {
    ($(#[$meta:meta])* $visible:vis fn $name:ident($($arg:ident: $kind:ty),* $(,)?) $(-> $result:ty)? = $inner:path) => {
        $(#[$meta])*
        $visible fn $name($($arg: $kind),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,popcnt")]
                #[allow(clippy::too_many_arguments)]
                fn wide($($arg: $kind),*) $(-> $result)? {
                    $inner($($arg),*)
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
                    // SAFETY: the processor has these instructions.
                    return unsafe { wide($($arg),*) };
                }
            }
            $inner($($arg),*)
        }
    };
}
pub(crate) use by_processor;
