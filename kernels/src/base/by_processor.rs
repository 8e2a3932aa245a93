//! Dispatch of inner loops to the widest SIMD instructions of the processor.

/// Define a function that is compiled for AVX2 and for the baseline, and dispatched at run time. Both
/// versions give identical bits: integer arithmetic is exact, and every floating-point product, sum and
/// quotient is rounded separately.
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
                    // SAFETY: the processor supports AVX2 and POPCNT.
                    return unsafe { wide($($arg),*) };
                }
            }
            $inner($($arg),*)
        }
    };
}
pub(crate) use by_processor;
