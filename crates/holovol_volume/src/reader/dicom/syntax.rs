use super::dataset::Encoding;

/// How a file's elements and pixels are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Syntax {
    pub explicit_vr: bool,
    pub big_endian: bool,
    pub deflated: bool,
    pub codec: Codec,
}

/// How pixels are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    Native,
    Rle,
    /// Baseline, extended (8 bits) and lossless.
    Jpeg,
    JpegLs,
    Jpeg2000,
}

impl Syntax {
    const NATIVE: Self = Self {
        explicit_vr: true,
        big_endian: false,
        deflated: false,
        codec: Codec::Native,
    };

    /// From a transfer syntax's UID; `Err` names what can't be read.
    pub fn from_uid(uid: &str) -> Result<Self, &'static str> {
        let codec = |codec| {
            Ok(Self {
                codec,
                ..Self::NATIVE
            })
        };
        match uid {
            "1.2.840.10008.1.2" => Ok(Self {
                explicit_vr: false,
                ..Self::NATIVE
            }),
            "1.2.840.10008.1.2.1" => Ok(Self::NATIVE),
            "1.2.840.10008.1.2.1.99" => Ok(Self {
                deflated: true,
                ..Self::NATIVE
            }),
            "1.2.840.10008.1.2.2" => Ok(Self {
                big_endian: true,
                ..Self::NATIVE
            }),
            "1.2.840.10008.1.2.4.50"
            | "1.2.840.10008.1.2.4.51"
            | "1.2.840.10008.1.2.4.57"
            | "1.2.840.10008.1.2.4.70" => codec(Codec::Jpeg),
            "1.2.840.10008.1.2.4.80" | "1.2.840.10008.1.2.4.81" => codec(Codec::JpegLs),
            "1.2.840.10008.1.2.4.90" | "1.2.840.10008.1.2.4.91" => codec(Codec::Jpeg2000),
            "1.2.840.10008.1.2.5" => codec(Codec::Rle),
            "1.2.840.10008.1.2.4.92" | "1.2.840.10008.1.2.4.93" => Err("JPEG 2000 part 2"),
            "1.2.840.10008.1.2.4.110" | "1.2.840.10008.1.2.4.111" | "1.2.840.10008.1.2.4.112" => {
                Err("JPEG XL")
            }
            "1.2.840.10008.1.2.4.201" | "1.2.840.10008.1.2.4.202" | "1.2.840.10008.1.2.4.203" => {
                Err("high-throughput JPEG 2000")
            }
            uid if uid.starts_with("1.2.840.10008.1.2.4.10") => Err("MPEG video"),
            _ => Err("an unknown transfer syntax"),
        }
    }

    /// What a data set without meta information uses, judged by its first element.
    pub fn guess(first_element: &[u8]) -> Self {
        let vr = first_element.get(4..6).unwrap_or_default();
        Self {
            explicit_vr: vr.len() == 2 && vr.iter().all(u8::is_ascii_uppercase),
            ..Self::NATIVE
        }
    }

    pub fn encoding(&self) -> Encoding {
        Encoding {
            explicit_vr: self.explicit_vr,
            big_endian: self.big_endian,
        }
    }
}
