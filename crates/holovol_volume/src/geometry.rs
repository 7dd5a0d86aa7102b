use glam::{DMat3, DMat4, DVec3, DVec4};

/// Where a file puts its voxels.
///
/// A header that knows the patient gives directions in RAS (right, anterior, superior) or LPS;
/// one that doesn't gives spacings only. [`Geometry::world_from_unit_cube`] turns either into
/// metres with the volume's centre at the origin: the patient's left to +x, superior to +y,
/// anterior to +z; without a patient, index axes i, j, k go to x, y, z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Metres per voxel step along i, j, k, as columns: in RAS if `oriented`, else along i, j, k.
    pub metres_from_index: DMat3,
    /// Position of voxel (0, 0, 0)'s centre in the same frame, metres.
    pub origin: DVec3,
    /// Whether the columns are anatomical (RAS) directions.
    pub oriented: bool,
}

impl Geometry {
    /// World directions of right, anterior, superior.
    const WORLD_FROM_RAS: DMat3 = DMat3::from_cols(
        DVec3::new(-1.0, 0.0, 0.0),
        DVec3::new(0.0, 0.0, 1.0),
        DVec3::new(0.0, 1.0, 0.0),
    );

    /// Spacings in metres along i, j, k, no orientation.
    pub fn from_spacing(metres: [f64; 3]) -> Self {
        Self {
            metres_from_index: DMat3::from_diagonal(DVec3::from_array(metres)),
            origin: DVec3::ZERO,
            oriented: false,
        }
    }

    /// Columns are metres per step along i, j, k in RAS.
    pub fn from_ras(metres_from_index: DMat3, origin: DVec3) -> Self {
        Self {
            metres_from_index,
            origin,
            oriented: true,
        }
    }

    /// Lengths of a voxel step along i, j, k in metres.
    pub fn spacing(&self) -> [f64; 3] {
        std::array::from_fn(|axis| self.metres_from_index.col(axis).length())
    }

    /// Whether i, j, k point along the frame's own axes, forwards.
    pub fn is_diagonal(&self) -> bool {
        (0..3).all(|axis| {
            let step = self.metres_from_index.col(axis);
            (0..3).all(|other| {
                if other == axis {
                    step[other] > 0.0
                } else {
                    step[other] == 0.0
                }
            })
        })
    }

    /// World metres from unit-cube coordinates, the cube's centre at the origin.
    pub fn world_from_unit_cube(&self, dims: [u32; 3]) -> DMat4 {
        let frame = if self.oriented {
            Self::WORLD_FROM_RAS
        } else {
            DMat3::IDENTITY
        };
        let edges = frame
            * self.metres_from_index
            * DMat3::from_diagonal(DVec3::from_array(dims.map(f64::from)));
        let corner = -0.5 * (edges.x_axis + edges.y_axis + edges.z_axis);
        DMat4::from_cols(
            edges.x_axis.extend(0.0),
            edges.y_axis.extend(0.0),
            edges.z_axis.extend(0.0),
            DVec4::new(corner.x, corner.y, corner.z, 1.0),
        )
    }

    /// The three letters that say where i, j, k point to mostly (`RAS`, `LPI`, …), if oriented.
    pub fn axis_codes(&self) -> Option<String> {
        const LETTERS: [[char; 2]; 3] = [['L', 'R'], ['P', 'A'], ['I', 'S']];
        self.oriented.then(|| {
            (0..3)
                .map(|axis| {
                    let step = self.metres_from_index.col(axis);
                    let main = (0..3)
                        .max_by(|&a, &b| step[a].abs().total_cmp(&step[b].abs()))
                        .unwrap_or(0);
                    LETTERS[main][usize::from(step[main] > 0.0)]
                })
                .collect()
        })
    }
}
