//! Which axes are space, and where they put the voxels.

use glam::{DMat3, DVec3};

use super::header::Header;
use crate::reader::placement::{METRES_PER_MM, check_directions, checked_origin, checked_spacing};
use crate::{Geometry, VolumeError};

/// The axes of a file.
pub(super) struct Axes {
    /// Sizes of all axes, fastest first.
    pub sizes: Vec<u64>,
    /// The indices of those that become x, y, z; fewer for images.
    pub spatial: Vec<usize>,
}

/// How the frame of `space directions` lies in ours.
enum Frame {
    /// To be multiplied into RAS.
    Anatomical(DVec3),
    /// No patient: straight to world x, y, z.
    World(DVec3),
}

impl Axes {
    /// Finds the spatial axes by `space directions`, else by `kinds`, else by order.
    pub fn new(header: &Header, notices: &mut Vec<String>) -> Result<Self, VolumeError> {
        let sizes = header.sizes()?;
        let kinds: Vec<String> = words(header.field("kinds").unwrap_or_default());
        let directions = space_directions(header, sizes.len())?;
        let mut spatial: Vec<usize> = (0..sizes.len())
            .filter(|&axis| match (&directions, kinds.get(axis)) {
                (Some(directions), _) => directions.get(axis).is_some_and(Option::is_some),
                (None, Some(kind)) => {
                    matches!(kind.as_str(), "domain" | "space" | "none" | "???")
                }
                (None, None) => true,
            })
            .collect();

        // A stack of slices may have its third axis called a list, or time.
        let steps = |axis: usize| !kinds.get(axis).is_some_and(|kind| is_of_components(kind));
        for axis in (0..sizes.len()).rev() {
            if spatial.len() < 3
                && !spatial.contains(&axis)
                && size(&sizes, axis) > 1
                && steps(axis)
            {
                spatial.push(axis);
                spatial.sort_unstable();
            }
        }
        // Axes of one step are the first to go where there are too many.
        while spatial.len() > 3 {
            let single = spatial.iter().rposition(|&axis| size(&sizes, axis) == 1);
            spatial.remove(single.unwrap_or(spatial.len() - 1));
        }
        if spatial.is_empty() {
            spatial.push(0);
        }
        for axis in 0..sizes.len() {
            if size(&sizes, axis) > 1 && !spatial.contains(&axis) {
                let kind = kinds.get(axis).map_or("no kind", String::as_str);
                notices.push(format!(
                    "axis {axis} ({kind}) has {} entries: this is the first",
                    size(&sizes, axis)
                ));
            }
        }
        Ok(Self { sizes, spatial })
    }

    /// Voxels along x, y, z.
    pub fn dims(&self, header: &Header) -> Result<[u32; 3], VolumeError> {
        let mut dims = [1; 3];
        for (dim, &axis) in dims.iter_mut().zip(&self.spatial) {
            let size = size(&self.sizes, axis);
            *dim = u32::try_from(size).map_err(|_| {
                header.error(
                    "sizes",
                    size.to_string(),
                    "at most 4294967295 along an axis",
                )
            })?;
        }
        Ok(dims)
    }

    /// The axes of which only the first entry is read, slowest first: steps along the axis, and
    /// numbers per step.
    pub fn reduced(&self) -> Vec<(u64, u64)> {
        (0..self.sizes.len())
            .rev()
            .filter(|axis| !self.spatial.contains(axis) && size(&self.sizes, *axis) > 1)
            .map(|axis| {
                let faster = self.sizes.iter().take(axis);
                let block = faster.fold(1u64, |product, &n| product.saturating_mul(n));
                (size(&self.sizes, axis), block)
            })
            .collect()
    }

    /// Spacing and orientation.
    pub fn geometry(
        &self,
        header: &Header,
        notices: &mut Vec<String>,
    ) -> Result<Geometry, VolumeError> {
        let Some(directions) = space_directions(header, self.sizes.len())? else {
            return Ok(Geometry::from_spacing(self.spacings(header, notices)?));
        };
        let per_unit = space_units(header, notices);
        let mut columns: Vec<DVec3> = self
            .spatial
            .iter()
            .map_while(|&axis| directions.get(axis).copied().flatten())
            .map(|direction| direction * per_unit)
            .collect();
        if let [first, second] = columns[..] {
            // An image is as thick as its pixels are wide.
            let thickness = first.length().min(second.length());
            columns.push(first.cross(second).normalize_or_zero() * thickness);
        }
        let lengths = [0, 1, 2].map(|axis| columns.get(axis).map_or(f64::NAN, |c| c.length()));
        let [x, y, z] = columns[..] else {
            notices.push("`space directions` lack an axis: orientation is not known".into());
            return Ok(Geometry::from_spacing(checked_spacing(
                lengths,
                1.0,
                "length of `space directions`",
                notices,
            )));
        };
        let directions = DMat3::from_cols(x, y, z);
        if let Err(problem) = check_directions(&directions) {
            notices.push(format!(
                "`space directions` are {problem}: orientation is not known"
            ));
            return Ok(Geometry::from_spacing(checked_spacing(
                lengths,
                1.0,
                "length of `space directions`",
                notices,
            )));
        }
        let origin = match header.field("space origin") {
            Some(text) => vectors(text)
                .and_then(|vectors| vectors.first().copied().flatten())
                .ok_or_else(|| {
                    header.error(
                        "space origin",
                        format!("{text:?}"),
                        "a vector such as (0,0,0)",
                    )
                })?,
            None => DVec3::ZERO,
        };
        let origin = checked_origin(origin * per_unit);
        let (signs, oriented) = match frame(header, notices)? {
            Frame::Anatomical(signs) => (signs, true),
            Frame::World(signs) => (signs, false),
        };
        Ok(Geometry {
            metres_from_index: DMat3::from_diagonal(signs) * directions,
            origin: signs * origin,
            oriented,
        })
    }

    fn spacings(
        &self,
        header: &Header,
        notices: &mut Vec<String>,
    ) -> Result<[f64; 3], VolumeError> {
        let (spacings, text) = if let Some(text) = header.field("spacings") {
            (self.numbers(header, "spacings", text)?, text)
        } else if let (Some(mins), Some(maxs)) =
            (header.field("axis mins"), header.field("axis maxs"))
        {
            (self.spacings_of_ends(header, mins, maxs)?, maxs)
        } else {
            notices.push("the header gives no spacings: taken as 1 mm".into());
            return Ok([METRES_PER_MM; 3]);
        };
        let units = quoted(header.field("units").unwrap_or_default());
        let metres: Vec<f64> = self
            .spatial
            .iter()
            .map(|&axis| {
                let unit = units.get(axis).map_or("", String::as_str);
                let spacing = spacings.get(axis).copied().unwrap_or(f64::NAN);
                spacing * metres_per(unit, notices)
            })
            .collect();
        let spacing = [0, 1, 2].map(|axis| metres.get(axis).copied());
        // An image is as thick as its pixels are wide; that needs no notice.
        let smallest = metres.iter().map(|m| m.abs()).fold(f64::INFINITY, f64::min);
        let spacing = spacing.map(|length| length.unwrap_or(smallest));
        if spacing
            .iter()
            .all(|length| !(length.abs() > 0.0 && length.is_finite()))
        {
            notices.push(format!("spacings are {text:?}: taken as 1 mm"));
            return Ok([METRES_PER_MM; 3]);
        }
        Ok(checked_spacing(spacing, 1.0, "spacing (m)", notices))
    }

    /// A field's numbers, one for each axis.
    fn numbers(&self, header: &Header, name: &str, text: &str) -> Result<Vec<f64>, VolumeError> {
        text.split_whitespace()
            .map(|word| word.parse().ok())
            .collect::<Option<_>>()
            .filter(|numbers: &Vec<f64>| numbers.len() == self.sizes.len())
            .ok_or_else(|| {
                header.error(
                    name,
                    format!("{text:?}"),
                    format!("{} numbers", self.sizes.len()),
                )
            })
    }

    /// The spacings of axes that are given by their ends: those of the outer voxels' centres where an
    /// axis is centred on nodes, of their faces elsewhere (Teem's default).
    fn spacings_of_ends(
        &self,
        header: &Header,
        mins: &str,
        maxs: &str,
    ) -> Result<Vec<f64>, VolumeError> {
        let mins = self.numbers(header, "axis mins", mins)?;
        let maxs = self.numbers(header, "axis maxs", maxs)?;
        let centers = header.field("centers").or(header.field("centerings"));
        let centers = words(centers.unwrap_or_default());
        let ends = mins.iter().zip(&maxs).enumerate();
        Ok(ends
            .map(|(axis, (min, max))| {
                let on_nodes = centers.get(axis).is_some_and(|center| center == "node");
                let steps = size(&self.sizes, axis).saturating_sub(on_nodes.into());
                (max - min) / steps as f64
            })
            .collect())
    }
}

fn size(sizes: &[u64], axis: usize) -> u64 {
    sizes.get(axis).copied().unwrap_or(1)
}

/// Whether the entries along such an axis are parts of one value, not steps through something.
fn is_of_components(kind: &str) -> bool {
    [
        "vector",
        "color",
        "complex",
        "matrix",
        "quaternion",
        "gradient",
        "normal",
        "point",
        "scalar",
        "stub",
    ]
    .iter()
    .any(|part| kind.contains(part))
}

fn frame(header: &Header, notices: &mut Vec<String>) -> Result<Frame, VolumeError> {
    let Some(space) = header.field("space") else {
        notices.push("no `space`: the patient's directions are not known".into());
        return Ok(Frame::World(DVec3::ONE));
    };
    Ok(match space.to_lowercase().as_str() {
        "right-anterior-superior" | "ras" | "right-anterior-superior-time" | "rast" => {
            Frame::Anatomical(DVec3::ONE)
        }
        "left-anterior-superior" | "las" | "left-anterior-superior-time" | "last" => {
            Frame::Anatomical(DVec3::new(-1.0, 1.0, 1.0))
        }
        "left-posterior-superior" | "lps" | "left-posterior-superior-time" | "lpst" => {
            Frame::Anatomical(DVec3::new(-1.0, -1.0, 1.0))
        }
        "scanner-xyz" | "scanner-xyz-time" => {
            notices.push("`space: scanner-xyz` says nothing of the patient: taken as RAS".into());
            Frame::Anatomical(DVec3::ONE)
        }
        "3d-right-handed" | "3d-right-handed-time" => Frame::World(DVec3::ONE),
        // Ours is right-handed: only a mirror keeps what lies on which side.
        "3d-left-handed" | "3d-left-handed-time" => Frame::World(DVec3::new(1.0, 1.0, -1.0)),
        _ => {
            return Err(header.error(
                "space",
                format!("{space:?}"),
                "right-anterior-superior, left-anterior-superior, left-posterior-superior, \
                 scanner-xyz, 3D-right-handed or 3D-left-handed",
            ));
        }
    })
}

/// `space directions`, one per axis; `None` for those that are not space.
fn space_directions(
    header: &Header,
    axes: usize,
) -> Result<Option<Vec<Option<DVec3>>>, VolumeError> {
    let Some(text) = header.field("space directions") else {
        return Ok(None);
    };
    vectors(text)
        .filter(|vectors| vectors.len() == axes)
        .map(Some)
        .ok_or_else(|| {
            header.error(
                "space directions",
                format!("{text:?}"),
                format!("{axes} vectors such as (1,0,0), or none for an axis that is not space"),
            )
        })
}

/// Vectors such as `(1,0,0) none (0, 1, 0)`; those of two numbers get a 0, more than three are cut.
fn vectors(text: &str) -> Option<Vec<Option<DVec3>>> {
    let mut vectors = Vec::new();
    let mut rest = text.trim_start();
    while !rest.is_empty() {
        if let Some(inner) = rest.strip_prefix('(') {
            let (numbers, after) = inner.split_once(')')?;
            let numbers: Vec<f64> = numbers
                .split(',')
                .map(|number| number.trim().parse().ok())
                .collect::<Option<_>>()?;
            let at = |axis: usize| numbers.get(axis).copied().unwrap_or(0.0);
            vectors.push(Some(DVec3::new(at(0), at(1), at(2))));
            rest = after.trim_start();
        } else {
            rest = rest.strip_prefix("none")?.trim_start();
            vectors.push(None);
        }
    }
    Some(vectors)
}

/// Metres per unit along each axis of space.
fn space_units(header: &Header, notices: &mut Vec<String>) -> DVec3 {
    let units = quoted(header.field("space units").unwrap_or_default());
    let mut metres = |axis: usize| metres_per(units.get(axis).map_or("", String::as_str), notices);
    DVec3::new(metres(0), metres(1), metres(2))
}

fn metres_per(unit: &str, notices: &mut Vec<String>) -> f64 {
    match unit.trim().to_lowercase().as_str() {
        "" | "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => METRES_PER_MM,
        "none" | "???" | "pixel" | "pixels" | "voxel" | "voxels" => METRES_PER_MM,
        "m" | "meter" | "meters" | "metre" | "metres" => 1.0,
        "km" => 1e3,
        "cm" | "centimeter" | "centimeters" => 1e-2,
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometers" => 1e-6,
        "nm" | "nanometer" | "nanometers" => 1e-9,
        "in" | "inch" | "inches" => 0.0254,
        other => {
            notices.push(format!("length unit {other:?} is not known: taken as mm"));
            METRES_PER_MM
        }
    }
}

/// Words in quotes: `"mm" "mm" ""`; words without them are taken as well.
fn quoted(text: &str) -> Vec<String> {
    if !text.contains('"') {
        return text.split_whitespace().map(str::to_owned).collect();
    }
    // Between quotes lie the odd parts.
    text.split('"')
        .skip(1)
        .step_by(2)
        .map(str::to_owned)
        .collect()
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_lowercase).collect()
}
