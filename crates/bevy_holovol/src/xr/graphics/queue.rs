//! One user at a time for the graphics queue.
//!
//! The runtime submits to the queue that it shares with wgpu within some of our calls to it, and
//! Vulkan wants that no two threads use a queue at once: workers upload volumes and light while a
//! frame is handed over. wgpu's own locks know nothing of the runtime. So a backend whose queues
//! need it lets wgpu reach the queue only [`exclusively`], and so do we with the runtime's calls.
//! Nobody holds this for longer than one such call takes.

use std::cell::Cell;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

/// There is one headset, and one queue with it.
static QUEUE: Mutex<()> = Mutex::new(());

thread_local! {
    static IS_MINE: Cell<bool> = const { Cell::new(false) };
}

/// Uses the queue while nobody else does.
///
/// Only for single calls to the runtime or the driver: wgpu waits here with its locks held, so that
/// whoever called wgpu from within might wait for ever.
pub(crate) fn exclusively<T>(use_queue: impl FnOnce() -> T) -> T {
    // A runtime's call that comes back to us has it already.
    if IS_MINE.get() {
        return use_queue();
    }
    let _queue = QUEUE.lock().unwrap_or_else(PoisonError::into_inner);
    let _mine = Mine::new();
    use_queue()
}

struct Mine;

impl Mine {
    fn new() -> Self {
        IS_MINE.set(true);
        Self
    }
}

impl Drop for Mine {
    fn drop(&mut self) {
        IS_MINE.set(false);
    }
}

/// Something of the runtime's that is destroyed [`exclusively`]: runtimes wait for the queue then.
pub(crate) struct Exclusive<T>(Option<T>);

impl<T> Exclusive<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(Some(value))
    }
}

impl<T> Deref for Exclusive<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0.as_ref().expect("there until it is dropped")
    }
}

impl<T> DerefMut for Exclusive<T> {
    fn deref_mut(&mut self) -> &mut T {
        self.0.as_mut().expect("there until it is dropped")
    }
}

impl<T> Drop for Exclusive<T> {
    fn drop(&mut self) {
        exclusively(|| self.0 = None);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;

    use super::*;

    /// Fails if another thread is in it.
    fn alone(is_used: &AtomicBool) {
        assert!(!is_used.swap(true, Ordering::SeqCst), "used by two");
        std::thread::sleep(Duration::from_micros(50));
        is_used.store(false, Ordering::SeqCst);
    }

    #[test]
    fn a_queue_has_one_user_at_a_time() {
        let is_used = AtomicBool::new(false);
        let is_used = &is_used;
        struct User<'a>(&'a AtomicBool);
        impl Drop for User<'_> {
            fn drop(&mut self) {
                alone(self.0);
            }
        }
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| (0..200).for_each(|_| exclusively(|| alone(is_used))));
            }
            for _ in 0..200 {
                drop(Exclusive::new(User(is_used)));
            }
        });
    }

    #[test]
    fn who_has_the_queue_may_ask_for_it_again() {
        assert_eq!(exclusively(|| exclusively(|| 7)), 7);
        let is_mine = std::panic::catch_unwind(|| exclusively(|| panic!("in a call"))).is_err();
        assert!(is_mine && !IS_MINE.get());
        assert_eq!(exclusively(|| 7), 7, "a panic leaves it free");
    }
}
