use crate::Image;

/// What all samples of a picture add up to: mean and spread of every pixel's independent samples.
#[derive(Clone, Debug)]
pub struct Film {
    width: u32,
    height: u32,
    samples: u64,
    pub(crate) pixels: Vec<Pixel>,
}

/// Running moments of one pixel (Welford 1962): R, G, B, opacity.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pixel {
    mean: [f64; 4],
    /// Sum of squared deviations from the mean.
    squares: [f64; 4],
}

impl Pixel {
    /// Adds the `count`-th sample, counted from 1.
    #[inline]
    pub(crate) fn add(&mut self, count: u64, sample: [f64; 4]) {
        for (channel, value) in sample.into_iter().enumerate() {
            let before = value - self.mean[channel];
            self.mean[channel] += before / count as f64;
            self.squares[channel] += before * (value - self.mean[channel]);
        }
    }
}

impl Film {
    /// A film without samples.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            samples: 0,
            pixels: vec![Pixel::default(); width as usize * height as usize],
        }
    }

    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Samples so far, of every pixel.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    pub(crate) fn add_samples(&mut self, count: u64) {
        self.samples += count;
    }

    /// Mean per pixel, row-major from the top left: premultiplied linear RGB and opacity.
    pub fn means(&self) -> impl ExactSizeIterator<Item = [f64; 4]> + '_ {
        self.pixels.iter().map(|pixel| pixel.mean)
    }

    /// Variance of each pixel's mean; 0 while there are fewer than two samples.
    pub fn variances(&self) -> impl ExactSizeIterator<Item = [f64; 4]> + '_ {
        let n = self.samples as f64;
        let scale = if self.samples > 1 {
            1.0 / (n * (n - 1.0))
        } else {
            0.0
        };
        self.pixels
            .iter()
            .map(move |pixel| pixel.squares.map(|squares| squares * scale))
    }

    /// The picture so far.
    pub fn image(&self) -> Image {
        let pixels = self.means().map(|mean| mean.map(|c| c as f32)).collect();
        Image::new(self.width, self.height, pixels)
    }
}
