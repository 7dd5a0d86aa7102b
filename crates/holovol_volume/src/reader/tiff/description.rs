//! What an `ImageDescription` says of a stack: OME-XML, or ImageJ's lines.

use std::collections::BTreeMap;

/// A longer description is refused: XML trees need many times their text.
const TEXT_BYTES_MAX: usize = 4 << 20;

/// An element or attribute of the tree takes about so many bytes, growing lists included ...
const NODE_BYTES: usize = 160;

/// ... of which there may be so many per byte of the file, beside [`TREE_BYTES_MIN`].
const TREE_BYTES_PER_BYTE: usize = 2;
const TREE_BYTES_MIN: usize = 1 << 20;

/// How pages are to be understood.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Description {
    pub slices: usize,
    pub channels: usize,
    pub times: usize,
    /// Of the three, the one that changes fastest from page to page, then the next.
    pub order: [Axis; 3],
    /// Metres along x, y, z; where the file says so.
    pub spacing: [Option<f64>; 3],
    pub channel_names: Vec<String>,
    /// Pages of planes (slice, channel, time) that are not in that order.
    pub pages: BTreeMap<[usize; 3], usize>,
    /// Another file that the planes lie in.
    pub elsewhere: Option<String>,
    /// ImageJ's: all planes follow the first, without pages of their own.
    pub is_imagej: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axis {
    Slice,
    Channel,
    Time,
}

impl Description {
    /// Pages are slices.
    pub fn plain(pages: usize) -> Self {
        Self {
            slices: pages,
            channels: 1,
            times: 1,
            order: [Axis::Slice, Axis::Channel, Axis::Time],
            spacing: [None; 3],
            channel_names: Vec::new(),
            pages: BTreeMap::new(),
            elsewhere: None,
            is_imagej: false,
        }
    }

    /// Understands the description in a file of `length` bytes; `None` if it is neither OME's nor
    /// ImageJ's, or needs far more memory than the file.
    pub fn parse(text: &str, length: u64) -> Option<Self> {
        let text = text.trim_start_matches('\u{feff}').trim();
        if text.len() > TEXT_BYTES_MAX {
            return None;
        }
        if text.starts_with("ImageJ=") {
            return imagej(text);
        }
        if text.starts_with('<') && text.contains("<OME") {
            return ome(text, length);
        }
        None
    }

    /// The page of a plane.
    pub fn page(&self, slice: usize, channel: usize, time: usize) -> usize {
        if let Some(page) = self.pages.get(&[slice, channel, time]) {
            return *page;
        }
        self.in_order([slice, channel, time])
    }

    fn size(&self, axis: &Axis) -> usize {
        match axis {
            Axis::Slice => self.slices,
            Axis::Channel => self.channels,
            Axis::Time => self.times,
        }
    }

    /// How many planes (slice, channel, time) come before one in the order of the axes.
    fn in_order(&self, [slice, channel, time]: [usize; 3]) -> usize {
        self.order.iter().rev().fold(0, |before, axis| {
            let index = match axis {
                Axis::Slice => slice,
                Axis::Channel => channel,
                Axis::Time => time,
            };
            before * self.size(axis) + index
        })
    }

    /// The same, of a plane that there is.
    fn place(&self, plane: [usize; 3]) -> Option<usize> {
        let sizes = [self.slices, self.channels, self.times];
        let is_inside = plane.iter().zip(sizes).all(|(&index, size)| index < size);
        self.planes()?;
        is_inside.then(|| self.in_order(plane))
    }

    /// The plane before which so many come.
    fn plane(&self, mut place: usize) -> [usize; 3] {
        let mut plane = [0; 3];
        for axis in &self.order {
            let size = self.size(axis).max(1);
            let index = match axis {
                Axis::Slice => 0,
                Axis::Channel => 1,
                Axis::Time => 2,
            };
            plane[index] = place % size;
            place /= size;
        }
        plane
    }

    /// Planes in all, if that can be counted.
    pub fn planes(&self) -> Option<usize> {
        self.slices
            .checked_mul(self.channels)?
            .checked_mul(self.times)
    }
}

fn imagej(text: &str) -> Option<Description> {
    let value = |name: &str| {
        text.lines()
            .filter_map(|line| line.split_once('='))
            .find(|(key, _)| key.trim() == name)
            .map(|(_, value)| value.trim())
    };
    let count = |name: &str| {
        value(name)
            .and_then(|n| n.parse::<usize>().ok())
            .filter(|&n| n > 0)
    };
    let images = count("images").unwrap_or(1);
    let channels = count("channels").unwrap_or(1);
    let times = count("frames").unwrap_or(1);
    let slices = count("slices")
        .unwrap_or_else(|| images / channels.saturating_mul(times).max(1))
        .max(1);
    let unit = value("unit").map_or(Some(1e-3), metres);
    let depth = value("spacing").and_then(|n| n.parse::<f64>().ok());
    Some(Description {
        slices,
        channels,
        times,
        order: [Axis::Channel, Axis::Slice, Axis::Time],
        // Along x and y the resolution tags say it, in the same unit.
        spacing: [
            unit,
            unit,
            depth.zip(unit).map(|(depth, unit)| depth.abs() * unit),
        ],
        channel_names: Vec::new(),
        pages: BTreeMap::new(),
        elsewhere: None,
        is_imagej: true,
    })
}

/// A page's directory alone takes as many bytes, whatever it holds.
const PAGE_BYTES_MIN: usize = 64;

fn ome(text: &str, length: u64) -> Option<Description> {
    // Elements begin with the one, attributes hold the other.
    let nodes = text.bytes().filter(|byte| b"<=".contains(byte)).count();
    let most = (length as usize)
        .saturating_mul(TREE_BYTES_PER_BYTE)
        .saturating_add(TREE_BYTES_MIN);
    if nodes.saturating_mul(NODE_BYTES) > most {
        return None;
    }
    let tree = roxmltree::Document::parse(text).ok()?;
    let pixels = tree
        .descendants()
        .find(|node| node.tag_name().name() == "Pixels")?;
    let count = |name: &str| {
        pixels
            .attribute(name)
            .and_then(|n| n.parse::<usize>().ok())
            .filter(|&n| n > 0)
    };
    let spacing = |axis: &str| {
        let length = pixels.attribute(format!("PhysicalSize{axis}").as_str())?;
        let unit = pixels.attribute(format!("PhysicalSize{axis}Unit").as_str());
        let metres = unit.map_or(Some(1e-6), metres)?;
        length.parse::<f64>().ok().map(|length| length * metres)
    };
    let letters = pixels.attribute("DimensionOrder")?.strip_prefix("XY")?;
    let axes: Option<Vec<Axis>> = letters
        .chars()
        .map(|letter| match letter {
            'Z' => Some(Axis::Slice),
            'C' => Some(Axis::Channel),
            'T' => Some(Axis::Time),
            _ => None,
        })
        .collect();
    let order = <[Axis; 3]>::try_from(axes?).ok()?;
    let children = |name: &'static str| {
        pixels
            .children()
            .filter(move |node| node.tag_name().name() == name)
    };
    let channel_names = children("Channel")
        .map(|channel| {
            let name = channel.attribute("Name").unwrap_or_default();
            name.chars().filter(|c| !c.is_control()).take(64).collect()
        })
        .collect();
    // Samples of one pixel are channels of OME, but lie in one page.
    let samples: usize = children("Channel")
        .filter_map(|channel| channel.attribute("SamplesPerPixel")?.parse::<usize>().ok())
        .max()
        .unwrap_or(1)
        .max(1);
    let mut description = Description {
        slices: count("SizeZ")?,
        channels: (count("SizeC")? / samples).max(1),
        times: count("SizeT")?,
        order,
        spacing: [spacing("X"), spacing("Y"), spacing("Z")],
        channel_names,
        pages: BTreeMap::new(),
        elsewhere: None,
        is_imagej: false,
    };
    // A plane's place is told by TiffData where it isn't in the order of the axes.
    let number = |node: &roxmltree::Node<'_, '_>, name: &str| {
        node.attribute(name).and_then(|n| n.parse::<usize>().ok())
    };
    let mut names = Vec::new();
    // A page takes more bytes than that.
    let mut planes_left = (length as usize / PAGE_BYTES_MIN).saturating_add(1024);
    for data in children("TiffData") {
        let uuid = data
            .children()
            .find(|node| node.tag_name().name() == "UUID");
        if let Some(name) = uuid.and_then(|uuid| uuid.attribute("FileName")) {
            names.push(name.to_owned());
        }
        let plane = ["FirstZ", "FirstC", "FirstT"].map(|name| number(&data, name).unwrap_or(0));
        let Some(first_page) = number(&data, "IFD") else {
            continue;
        };
        // The planes after the first follow in the order of the axes.
        let count = number(&data, "PlaneCount").unwrap_or(1).min(planes_left);
        planes_left -= count;
        let Some(first) = description.place(plane) else {
            continue;
        };
        let planes = description.planes().unwrap_or(0);
        for step in 0..count.min(planes.saturating_sub(first)) {
            let plane @ [slice, channel, time] = description.plane(first + step);
            let page = first_page.saturating_add(step);
            if description.page(slice, channel, time) != page {
                description.pages.insert(plane, page);
            }
        }
    }
    names.dedup();
    if let [_, other, ..] = names.as_slice() {
        description.elsewhere = Some(other.clone());
    }
    Some(description)
}

/// Metres per unit; `None` for what is no length.
fn metres(unit: &str) -> Option<f64> {
    Some(match unit.trim() {
        "m" => 1.0,
        "cm" => 1e-2,
        "mm" => 1e-3,
        "µm" | "μm" | "um" | "micron" | "microns" | "\\u00B5m" => 1e-6,
        "nm" => 1e-9,
        "pm" => 1e-12,
        "Å" => 1e-10,
        "in" | "inch" => 0.0254,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_of_planes_follow_the_dimension_order() {
        let text = "<OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\"><Image>\
            <Pixels DimensionOrder=\"XYCZT\" SizeX=\"4\" SizeY=\"3\" SizeZ=\"5\" SizeC=\"2\" \
            SizeT=\"3\" PhysicalSizeX=\"0.5\" PhysicalSizeZ=\"2\" PhysicalSizeZUnit=\"nm\" \
            Type=\"uint8\"><TiffData IFD=\"7\" FirstZ=\"1\" FirstC=\"0\" FirstT=\"0\" \
            PlaneCount=\"1\"/></Pixels></Image></OME>";
        let found = Description::parse(text, 1000).expect("it is OME");
        assert_eq!((found.slices, found.channels, found.times), (5, 2, 3));
        assert_eq!(found.page(3, 1, 2), 1 + 2 * (3 + 5 * 2));
        assert_eq!(found.page(1, 0, 0), 7);
        // Channels in blocks: the first one lies behind the second.
        let blocks = text.replace("XYCZT", "XYZCT").replace(
            "<TiffData IFD=\"7\" FirstZ=\"1\" FirstC=\"0\" FirstT=\"0\" PlaneCount=\"1\"/>",
            "<TiffData IFD=\"5\" FirstC=\"0\" PlaneCount=\"5\"/>\
             <TiffData IFD=\"0\" FirstC=\"1\" PlaneCount=\"5\"/>",
        );
        let found = Description::parse(&blocks, 1000).expect("it is OME");
        assert_eq!([0, 1, 4].map(|slice| found.page(slice, 0, 0)), [5, 6, 9]);
        assert_eq!([0, 1, 4].map(|slice| found.page(slice, 1, 0)), [0, 1, 4]);
        assert_eq!(found.page(2, 0, 1), 12);
        assert_eq!(found.spacing, [Some(5e-7), None, Some(2e-9)]);
    }

    #[test]
    fn imagej_counts_channels_first() {
        let text = "ImageJ=1.54\nimages=12\nchannels=2\nslices=3\nframes=2\nhyperstack=true\n\
            spacing=1.5\nunit=um\n";
        let found = Description::parse(text, 1000).expect("it is ImageJ's");
        assert_eq!(found.page(2, 1, 1), 1 + 2 * (2 + 3));
        assert_eq!(found.spacing[2], Some(1.5e-6));
    }
}
