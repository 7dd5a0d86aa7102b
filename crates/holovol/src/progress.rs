//! Progress on standard error: a bar on a terminal, else a line now and then.

use std::cell::Cell;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Steps of a bar: fine enough for any terminal.
const STEPS: u64 = 1000;
/// Where nobody watches a bar, a line this often shows that work goes on.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// How far some work is, from 0 to 1.
pub(crate) struct Bar {
    bar: ProgressBar,
    what: String,
    started: Cell<Instant>,
    /// When the last line was printed, where there is no terminal.
    line: Option<Cell<Instant>>,
}

impl Bar {
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
        let style = ProgressStyle::with_template("{prefix:>12} {wide_bar} {percent:>3} %  {msg}");
        // The template is ours; the default style is good enough should it ever be wrong.
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.set_prefix(what.to_owned());
        bar.tick();
        let now = Instant::now();
        Self {
            bar,
            what: what.to_owned(),
            started: Cell::new(now),
            line: (!std::io::stderr().is_terminal()).then(|| Cell::new(now)),
        }
    }

    /// Shows how much is done, 0 … 1, with a short text. Time is counted from the last 0.
    pub(crate) fn set(&self, done: f64, text: &str) {
        let done = done.clamp(0.0, 1.0);
        if done == 0.0 {
            self.started.set(Instant::now());
        }
        let mut message = text.to_owned();
        if done > 0.0 {
            let left = self.started.get().elapsed().as_secs_f64() * (1.0 - done) / done;
            if !message.is_empty() {
                message += ", ";
            }
            message += &duration(left);
            message += " left";
        }
        if let Some(line) = &self.line
            && line.get().elapsed() >= LINE_EVERY
        {
            line.set(Instant::now());
            eprintln!("{}: {:.0} %, {message}", self.what, 100.0 * done);
        }
        self.bar.set_message(message);
        self.bar.set_position((done * STEPS as f64) as u64);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Seconds as people say them.
fn duration(seconds: f64) -> String {
    let seconds = seconds.ceil() as u64;
    match seconds {
        0..120 => format!("{seconds} s"),
        120..7200 => format!("{} min", seconds.div_ceil(60)),
        _ => format!("{} h", seconds.div_ceil(3600)),
    }
}

#[cfg(test)]
mod tests {
    use super::duration;

    #[test]
    fn durations_read_well() {
        assert_eq!(duration(0.2), "1 s");
        assert_eq!(duration(119.0), "119 s");
        assert_eq!(duration(121.0), "3 min");
        assert_eq!(duration(7201.0), "3 h");
    }
}
