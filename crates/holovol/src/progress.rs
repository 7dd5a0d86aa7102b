//! Progress bars, on a terminal only.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Steps of a bar: fine enough for any terminal.
const STEPS: u64 = 1000;

/// A bar that goes from 0 to 1, on standard error; invisible where that is no terminal.
pub(crate) struct Bar(ProgressBar);

impl Bar {
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
        let style = ProgressStyle::with_template(
            "{prefix:>12} {wide_bar} {percent:>3} %  {msg}  ETA {eta}",
        );
        // The template is ours; the default style is good enough should it ever be wrong.
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_prefix(what.to_owned());
        Self(bar)
    }

    /// Shows how much is done, 0 … 1.
    pub(crate) fn set(&self, done: f64) {
        self.0
            .set_position((done.clamp(0.0, 1.0) * STEPS as f64) as u64);
    }

    /// Shows a short text behind the bar.
    pub(crate) fn say(&self, text: String) {
        self.0.set_message(text);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
