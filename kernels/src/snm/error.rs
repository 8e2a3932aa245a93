//! Errors of reading and writing `.snm` files.

use std::fmt;

use crate::base::errors::KernelError;

/// Error of reading or writing an `.snm` file.
#[derive(Clone, Debug, PartialEq)]
pub enum SnmError {
    /// The first bytes are wrong.
    Magic,
    /// The version is unknown, probably newer.
    Version(u8),
    /// The file ends within a part: 0 is the base mesh, k the k-th refinement.
    Truncated { part: usize },
    /// A part has a wrong checksum or decodes to invalid data.
    Damaged { part: usize },
    /// Bytes follow the last refinement.
    TrailingBytes { bytes: usize },
    /// The base mesh to write is not manifold.
    Mesh(KernelError),
    /// The input does not fit the format, or contradicts earlier input.
    InvalidInput(&'static str),
}

impl fmt::Display for SnmError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |part: &usize| match part {
            0 => "the base mesh".to_owned(),
            level => format!("level {level}"),
        };
        match self {
            Self::Magic => write!(f, "this is not an .snm file"),
            Self::Version(version) => {
                write!(f, "version {version} of the format is not supported; versions 1 and 2 are")
            }
            Self::Truncated { part } => write!(f, "the file is truncated in {}", name(part)),
            Self::Damaged { part } => write!(f, "{} is damaged", name(part)),
            Self::TrailingBytes { bytes } => write!(f, "{bytes} unexpected bytes follow the last level"),
            Self::Mesh(why) => why.fmt(f),
            Self::InvalidInput(why) => write!(f, "{why}"),
        }
    }
}

impl std::error::Error for SnmError {}

/// Convert errors of the writer.
impl From<SnmError> for KernelError {
    fn from(error: SnmError) -> Self {
        match error {
            SnmError::Mesh(why) => why,
            SnmError::InvalidInput(why) => Self::NotEncodable(why),
            _ => Self::NotEncodable("the encoder failed"),
        }
    }
}
