//! Work on the pieces of a volume by all cores, with the caller's thread telling the progress.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

/// Does `work` on each item, in order of their start, on as many threads as there are cores.
///
/// `done` runs on the calling thread with what `work` returned. The first error, of either, stops
/// all and is returned.
pub(super) fn for_each<I: Send, T: Send, E: Send>(
    items: impl Iterator<Item = I> + Send,
    work: impl Fn(I) -> Result<T, E> + Sync,
    mut done: impl FnMut(T) -> Result<(), E>,
) -> Result<(), E> {
    // A single piece needs no threads.
    if items.size_hint().1.is_some_and(|most| most <= 1) {
        for item in items {
            done(work(item)?)?;
        }
        return Ok(());
    }
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let items = Mutex::new(items);
    let stop = AtomicBool::new(false);
    let next = || {
        let mut items = items.lock().unwrap_or_else(|error| error.into_inner());
        (!stop.load(Ordering::Relaxed))
            .then(|| items.next())
            .flatten()
    };
    let (results, told) = mpsc::channel();
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let results = results.clone();
            let (next, work, stop) = (&next, &work, &stop);
            scope.spawn(move || {
                while let Some(item) = next() {
                    let result = work(item);
                    if result.is_err() {
                        stop.store(true, Ordering::Relaxed);
                    }
                    if results.send(result).is_err() {
                        break;
                    }
                }
            });
        }
        drop(results);
        let mut first = Ok(());
        for result in told {
            if first.is_err() {
                continue;
            }
            first = result.and_then(&mut done);
            if first.is_err() {
                stop.store(true, Ordering::Relaxed);
            }
        }
        first
    })
}
