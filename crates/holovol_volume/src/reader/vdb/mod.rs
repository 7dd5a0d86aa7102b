//! OpenVDB files (versions 222 to 224): scalar grids of the usual 5-4-3 tree.
//!
//! What is active, tiles included, fills a dense volume; inactive voxels in its box have their
//! stored values (the background, or the inside of a level set). Values may have any size. Lengths
//! are metres. Own code: `vdb-rs` 0.6 reserves the lengths that a file claims, panics on what it does
//! not know, and binds the C Blosc.

mod blosc;
mod grid;
mod stream;
mod tree;

use std::path::PathBuf;

use super::options::{Content, chosen};
use super::source::Source;
use super::{Input, Progress, ReadOptions, VolumeReader, limits};
use crate::{SourceFormat, Volume, VolumeError, Voxels};
use grid::{Descriptor, Transform};
use stream::Stream;
use tree::{Dense, Packing};

/// The grid that is read where there are several and nobody chose.
const PREFERRED: &str = "density";

/// Progress is told after this many leaves.
const LEAVES_TOLD: usize = 512;

/// Reads OpenVDB.
#[derive(Clone, Copy, Debug)]
pub struct VdbReader;

impl VolumeReader for VdbReader {
    fn name(&self) -> &'static str {
        "OpenVDB"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &[".vdb"]
    }

    fn recognises(&self, first_bytes: &[u8]) -> bool {
        first_bytes.starts_with(b" BDV\0\0\0\0")
    }

    fn read(
        &self,
        input: Input<'_>,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        VdbFile::open(input)?.read(options, progress)
    }

    fn contents(
        &self,
        input: Input<'_>,
        _options: &ReadOptions,
    ) -> Result<Vec<Content>, VolumeError> {
        let file = VdbFile::open(input)?;
        let grids = grid::list(&mut file.stream())?;
        Ok(readable(&grids).map(content).collect())
    }
}

fn readable(grids: &[Descriptor]) -> impl Iterator<Item = &Descriptor> {
    grids.iter().filter(|grid| grid.values.is_some())
}

fn content(grid: &Descriptor) -> Content {
    Content {
        name: grid.name.clone(),
        description: format!(
            "{}{}",
            grid.values.map_or("", |values| values.name()),
            if grid.is_half {
                " (stored as half)"
            } else {
                ""
            }
        ),
        ..Content::default()
    }
}

struct VdbFile<'a> {
    path: PathBuf,
    source: Source<'a>,
}

impl<'a> VdbFile<'a> {
    fn open(input: Input<'a>) -> Result<Self, VolumeError> {
        Ok(Self {
            path: input.path().to_path_buf(),
            source: input.into_source()?,
        })
    }

    fn stream(&self) -> Stream<'a> {
        Stream::new(
            self.source.cursor(0),
            self.path.clone(),
            self.source.length(),
        )
    }

    fn choose<'g>(
        &self,
        stream: &Stream<'_>,
        grids: &'g [Descriptor],
        options: &ReadOptions,
    ) -> Result<&'g Descriptor, VolumeError> {
        let there: Vec<&Descriptor> = readable(grids).collect();
        let contents: Vec<Content> = there.iter().map(|grid| content(grid)).collect();
        let index = match (&options.choice, there.len()) {
            (_, 0) => {
                let types: Vec<String> = grids
                    .iter()
                    .take(8)
                    .map(|grid| format!("{} ({})", grid.name, grid.tree))
                    .collect();
                return Err(stream.unsupported(
                    format!(
                        "no grid of single numbers is in this file: [{}]",
                        types.join(", ")
                    ),
                    "save a float grid (Tree_float_5_4_3)",
                ));
            }
            (Some(choice), _) => {
                chosen(choice, &contents).ok_or_else(|| VolumeError::NoSuchChoice {
                    path: self.path.clone(),
                    choice: choice.clone(),
                    contents: contents.clone(),
                })?
            }
            (None, 1) => 0,
            (None, _) => chosen(PREFERRED, &contents).ok_or_else(|| VolumeError::Choose {
                path: self.path.clone(),
                what: "grids",
                contents: contents.clone(),
            })?,
        };
        there
            .get(index)
            .copied()
            .ok_or_else(|| VolumeError::Changed {
                path: self.path.clone(),
            })
    }

    fn read(
        &self,
        options: &ReadOptions,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Volume, VolumeError> {
        let mut stream = self.stream();
        let grids = grid::list(&mut stream)?;
        let grid = self.choose(&stream, &grids, options)?;
        let Some(values) = grid.values else {
            return Err(stream.error("grid type", grid.tree.clone(), "a scalar grid"));
        };
        // An instance shares another grid's tree and has its own place.
        stream.go_to(grid.grid_at, "grid offset")?;
        let (transform, compression) = read_start(&mut stream)?;
        let mut packing = Packing {
            values,
            is_half: grid.is_half,
            compression,
        };
        let mut tree = grid;
        if !grid.instance_of.is_empty() {
            tree = grids
                .iter()
                .find(|other| {
                    other.name == grid.instance_of
                        && other.instance_of.is_empty()
                        && other.values == grid.values
                })
                .ok_or_else(|| {
                    stream.error(
                        "grid instance",
                        grid.instance_of.clone(),
                        "a grid of this file",
                    )
                })?;
            stream.go_to(tree.grid_at, "grid offset")?;
            packing.compression = read_start(&mut stream)?.1;
            packing.is_half = tree.is_half;
        }

        // Topology is read twice: for the bounds, then for the tiles, of which no list is kept.
        let topology = tree::read_topology(&mut stream, packing, None)?;
        let bounds = topology.bounds;
        let Some(dims) = bounds.dims() else {
            return Err(stream.unsupported(
                format!("the grid {:?} has no active voxels", grid.name),
                "choose another grid",
            ));
        };
        let count = dims
            .iter()
            .try_fold(1u64, |product, &n| product.checked_mul(n.into()));
        let total_bytes = limits::check_voxel_bytes(
            &self.path,
            count.and_then(|count| count.checked_mul(4)),
            options,
        )?;
        let mut voxels: Vec<f32> = Vec::new();
        voxels
            .try_reserve_exact((total_bytes / 4) as usize)
            .map_err(|_| VolumeError::TooLarge {
                path: self.path.clone(),
                bytes: total_bytes,
                limit: "the memory that is free".into(),
            })?;
        voxels.resize((total_bytes / 4) as usize, topology.background);
        let mut dense = Dense {
            bounds,
            dims,
            voxels: &mut voxels,
        };
        stream.go_to(tree.grid_at, "grid offset")?;
        read_start(&mut stream)?;
        tree::read_topology(&mut stream, packing, Some(&mut dense))?;

        stream.go_to(tree.blocks_at, "block offset")?;
        let mut rounded = topology.rounded;
        let leaves = topology.leaves.len();
        for (number, origin) in topology.leaves.into_iter().enumerate() {
            if number % LEAVES_TOLD == 0 {
                if options.cancel.is_cancelled() {
                    return Err(VolumeError::Cancelled {
                        path: self.path.clone(),
                    });
                }
                if number > 0 {
                    progress(Progress {
                        bytes: (total_bytes as f64 * number as f64 / leaves as f64) as u64,
                        total_bytes,
                    });
                }
            }
            let values = tree::read_leaf(&mut stream, packing, topology.background, &mut rounded)?;
            dense.put_leaf(origin, &values);
        }
        progress(Progress {
            bytes: total_bytes,
            total_bytes,
        });
        let mut volume = Volume::new(
            Voxels::F32(voxels),
            dims,
            1.0,
            0.0,
            transform.geometry(bounds.low),
        )?
        .with_rounded(rounded)
        .with_source_format(SourceFormat {
            name: "OpenVDB",
            numbers: if packing.is_half {
                "f16"
            } else {
                values.name()
            },
        });
        if rounded {
            volume = volume.with_notice("values are kept as f32: some are rounded");
        }
        if grids.len() > 1 {
            volume = volume.with_notice(format!(
                "the file has {} grids: this is {:?}; another can be chosen",
                grids.len(),
                grid.name
            ));
        }
        Ok(volume)
    }
}

/// What comes before a grid's tree.
fn read_start(stream: &mut Stream<'_>) -> Result<(Transform, u32), VolumeError> {
    let compression = stream.u32()?;
    stream.skip_metadata()?;
    Ok((Transform::read(stream)?, compression))
}
