use std::fmt;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// What shows where the volume is transparent: `"black"`, `"environment"`, `"transparent"` or a
/// colour `[r, g, b]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Background {
    /// Nothing: the picture is opaque and black there.
    #[default]
    Black,
    /// The light that the scene stands in, as the camera sees it.
    Environment,
    /// The picture keeps the opacity.
    Transparent,
    /// One colour: linear RGB in display light, each 0 … 1; neither exposed nor tone-mapped.
    Color([f64; 3]),
}

const NAMES: [(&str, Background); 3] = [
    ("black", Background::Black),
    ("environment", Background::Environment),
    ("transparent", Background::Transparent),
];

impl Serialize for Background {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Color(color) => color.serialize(serializer),
            named => {
                let name = NAMES.iter().find(|(_, value)| value == named);
                serializer.serialize_str(name.map_or("black", |(name, _)| name))
            }
        }
    }
}

impl<'de> Deserialize<'de> for Background {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NameOrColor;
        impl<'de> Visitor<'de> for NameOrColor {
            type Value = Background;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("\"black\", \"environment\", \"transparent\" or a colour [r, g, b]")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Background, E> {
                let found = NAMES.iter().find(|(name, _)| *name == text);
                found
                    .map(|&(_, value)| value)
                    .ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(text), &self))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Background, A::Error> {
                let mut color = [0.0; 3];
                for (index, channel) in color.iter_mut().enumerate() {
                    *channel = seq
                        .next_element()?
                        .ok_or_else(|| A::Error::invalid_length(index, &self))?;
                }
                match seq.next_element::<serde::de::IgnoredAny>()? {
                    None => Ok(Background::Color(color)),
                    Some(_) => Err(A::Error::invalid_length(4, &self)),
                }
            }
        }
        deserializer.deserialize_any(NameOrColor)
    }
}
