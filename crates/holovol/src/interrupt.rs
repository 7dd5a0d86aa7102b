//! Ctrl-C: tracing ends early and keeps its samples; anything else ends at once.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::{Exit, Failure};

static IS_TRACING: AtomicBool = AtomicBool::new(false);
static IS_ASKED: AtomicBool = AtomicBool::new(false);

/// While it lives, the first Ctrl-C asks to stop; the second ends the process.
pub(crate) struct Interruptible(());

impl Interruptible {
    /// # Errors
    /// If the system gives no handler.
    pub(crate) fn new() -> Result<Self, Failure> {
        static INSTALLED: std::sync::Once = std::sync::Once::new();
        let mut installed = Ok(());
        INSTALLED.call_once(|| installed = ctrlc::set_handler(handle));
        installed.map_err(|error| Failure::new(Exit::Internal, format!("Ctrl-C: {error}")))?;
        IS_TRACING.store(true, Ordering::SeqCst);
        Ok(Self(()))
    }
}

impl Drop for Interruptible {
    fn drop(&mut self) {
        IS_TRACING.store(false, Ordering::SeqCst);
    }
}

fn handle() {
    if IS_TRACING.load(Ordering::SeqCst) && !IS_ASKED.swap(true, Ordering::SeqCst) {
        eprintln!("\nnote: stopping; what is traced is kept (Ctrl-C again ends at once)");
    } else {
        std::process::exit(Exit::Interrupted as i32);
    }
}

/// Whether the user asked to stop.
pub(crate) fn is_asked() -> bool {
    IS_ASKED.load(Ordering::SeqCst)
}
