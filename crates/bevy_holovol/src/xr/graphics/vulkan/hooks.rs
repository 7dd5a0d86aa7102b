//! wgpu's way to the queue, through [`exclusively`].
//!
//! wgpu can't be asked to lock its queue against others, and it is submitted to from anywhere:
//! Bevy's systems, our workers, other plugins. But wgpu finds Vulkan's functions through the one that
//! looks them up, and gets that one from us: of those that use the queue it gets ours. Apps without
//! a headset have nothing of this.

use std::ffi::{CStr, c_char, c_void};
use std::mem::transmute;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{PoisonError, RwLock};

use ash::vk;

use super::super::queue::exclusively;

/// A device, its one queue, and the driver's functions that use it: all of these that wgpu-hal 29
/// calls.
#[derive(Clone, Copy)]
struct Hooked {
    device: vk::Device,
    queue: vk::Queue,
    look_up: vk::PFN_vkGetDeviceProcAddr,
    submit: vk::PFN_vkQueueSubmit,
    wait_idle: vk::PFN_vkDeviceWaitIdle,
    /// Where windows can be drawn.
    present: Option<vk::PFN_vkQueuePresentKHR>,
}

/// Those that are gone stay until their handles come again: they are few.
static DEVICES: RwLock<Vec<Hooked>> = RwLock::new(Vec::new());

/// The driver's own way to functions of devices that others make from our instance.
static OTHERS: RwLock<Option<vk::PFN_vkGetDeviceProcAddr>> = RwLock::new(None);

static SUBMISSIONS: AtomicU64 = AtomicU64::new(0);

/// How often wgpu has submitted to queues of headsets.
pub(crate) fn submissions() -> u64 {
    SUBMISSIONS.load(Ordering::Relaxed)
}

/// An instance whose devices' queues are used through here, once they are [`add_device`]d; other
/// devices of it, which no runtime shares, are left alone.
#[expect(
    unsafe_code,
    reason = "functions of Vulkan are pointers without a type"
)]
pub(super) fn load_instance(entry: &ash::Entry, instance: vk::Instance) -> ash::Instance {
    let find = |name: &CStr| {
        // SAFETY: names end with a zero.
        unsafe { (entry.static_fn().get_instance_proc_addr)(instance, name.as_ptr()) }
    };
    // SAFETY: of this name is a function of this type.
    let others = find(c"vkGetDeviceProcAddr").map(|look_up| unsafe { transmute(look_up) });
    *OTHERS.write().unwrap_or_else(PoisonError::into_inner) = others;
    let look_up = |name: &CStr| {
        if name == c"vkGetDeviceProcAddr" {
            return device_proc_addr as *const c_void;
        }
        // SAFETY: a function, or null.
        unsafe { transmute(find(name)) }
    };
    // SAFETY: these are the functions of these names, ours being of the same type.
    unsafe { ash::Instance::load_with(look_up, instance) }
}

/// The device as its instance loads it; only the first queue of that family may be used.
///
/// # Safety
/// It must have been made from the instance, with such a queue.
#[expect(
    unsafe_code,
    reason = "functions of Vulkan are pointers without a type"
)]
pub(super) unsafe fn add_device(
    entry: &ash::Entry,
    instance: &ash::Instance,
    device: vk::Device,
    family: u32,
) -> Option<ash::Device> {
    let name = c"vkGetDeviceProcAddr".as_ptr();
    // SAFETY: the functions are the driver's for this device, and of the types of their names.
    let hooked = unsafe {
        let look_up = (entry.static_fn().get_instance_proc_addr)(instance.handle(), name)?;
        let look_up: vk::PFN_vkGetDeviceProcAddr = transmute(look_up);
        let find = |name: &CStr| look_up(device, name.as_ptr());
        let get_queue: vk::PFN_vkGetDeviceQueue = transmute(find(c"vkGetDeviceQueue")?);
        let mut queue = vk::Queue::null();
        get_queue(device, family, 0, &mut queue);
        let submit: vk::PFN_vkQueueSubmit = transmute(find(c"vkQueueSubmit")?);
        let wait_idle: vk::PFN_vkDeviceWaitIdle = transmute(find(c"vkDeviceWaitIdle")?);
        let present: Option<vk::PFN_vkQueuePresentKHR> = transmute(find(c"vkQueuePresentKHR"));
        Hooked {
            device,
            queue,
            look_up,
            submit,
            wait_idle,
            present,
        }
    };
    add(hooked);
    // SAFETY: the instance's function looks them up for this device.
    Some(unsafe { ash::Device::load(instance.fp_v1_0(), device) })
}

fn add(hooked: Hooked) {
    let mut devices = DEVICES.write().unwrap_or_else(PoisonError::into_inner);
    devices.retain(|known| known.device != hooked.device && known.queue != hooked.queue);
    devices.push(hooked);
}

fn find(is_it: impl Fn(&Hooked) -> bool) -> Option<Hooked> {
    let devices = DEVICES.read().unwrap_or_else(PoisonError::into_inner);
    devices.iter().copied().find(|hooked| is_it(hooked))
}

#[expect(unsafe_code, reason = "called as Vulkan's function of this name")]
unsafe extern "system" fn device_proc_addr(
    device: vk::Device,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    let Some(hooked) = find(|hooked| hooked.device == device) else {
        let others = *OTHERS.read().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: as the caller's.
        return others.and_then(|look_up| unsafe { look_up(device, name) });
    };
    // SAFETY: as the caller's; ours are of the types of their names.
    unsafe {
        let theirs = (hooked.look_up)(device, name)?;
        let ours = match CStr::from_ptr(name).to_bytes() {
            b"vkQueueSubmit" => queue_submit as *const c_void,
            b"vkQueuePresentKHR" => queue_present as *const c_void,
            b"vkDeviceWaitIdle" => device_wait_idle as *const c_void,
            _ => return Some(theirs),
        };
        transmute(ours)
    }
}

#[expect(unsafe_code, reason = "called as Vulkan's function of this name")]
unsafe extern "system" fn queue_submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo<'_>,
    fence: vk::Fence,
) -> vk::Result {
    let Some(hooked) = find(|hooked| hooked.queue == queue) else {
        return vk::Result::ERROR_DEVICE_LOST;
    };
    SUBMISSIONS.fetch_add(1, Ordering::Relaxed);
    // SAFETY: as the caller's.
    exclusively(|| unsafe { (hooked.submit)(queue, count, submits, fence) })
}

#[expect(unsafe_code, reason = "called as Vulkan's function of this name")]
unsafe extern "system" fn queue_present(
    queue: vk::Queue,
    info: *const vk::PresentInfoKHR<'_>,
) -> vk::Result {
    let hooked = find(|hooked| hooked.queue == queue);
    let Some(present) = hooked.and_then(|hooked| hooked.present) else {
        return vk::Result::ERROR_DEVICE_LOST;
    };
    // SAFETY: as the caller's.
    exclusively(|| unsafe { present(queue, info) })
}

#[expect(unsafe_code, reason = "called as Vulkan's function of this name")]
unsafe extern "system" fn device_wait_idle(device: vk::Device) -> vk::Result {
    let Some(hooked) = find(|hooked| hooked.device == device) else {
        return vk::Result::ERROR_DEVICE_LOST;
    };
    // SAFETY: as the caller's.
    exclusively(|| unsafe { (hooked.wait_idle)(device) })
}

#[cfg(test)]
#[expect(unsafe_code, reason = "functions of Vulkan, made up")]
mod tests {
    use std::sync::atomic::AtomicBool;

    use ash::vk::Handle as _;

    use super::*;

    static IS_USED: AtomicBool = AtomicBool::new(false);

    fn alone() -> vk::Result {
        assert!(!IS_USED.swap(true, Ordering::SeqCst), "used by two");
        std::thread::sleep(std::time::Duration::from_micros(50));
        IS_USED.store(false, Ordering::SeqCst);
        vk::Result::SUCCESS
    }

    unsafe extern "system" fn submit(
        _: vk::Queue,
        _: u32,
        _: *const vk::SubmitInfo<'_>,
        _: vk::Fence,
    ) -> vk::Result {
        alone()
    }

    unsafe extern "system" fn present(
        _: vk::Queue,
        _: *const vk::PresentInfoKHR<'_>,
    ) -> vk::Result {
        alone()
    }

    unsafe extern "system" fn wait_idle(_: vk::Device) -> vk::Result {
        alone()
    }

    unsafe extern "system" fn look_up(
        device: vk::Device,
        name: *const c_char,
    ) -> vk::PFN_vkVoidFunction {
        assert_eq!(device, vk::Device::from_raw(1));
        // SAFETY: the tests' own names; what is returned is never called through this type.
        unsafe {
            transmute(match CStr::from_ptr(name).to_bytes() {
                b"vkQueueSubmit" => submit as *const c_void,
                b"vkDeviceWaitIdle" => wait_idle as *const c_void,
                b"vkQueueWaitIdle" => alone as *const c_void,
                _ => std::ptr::null(),
            })
        }
    }

    /// As wgpu finds and calls them, beside a runtime that uses the queue.
    #[test]
    fn what_wgpu_finds_waits_for_the_runtime() {
        let (device, queue) = (vk::Device::from_raw(1), vk::Queue::from_raw(2));
        add(Hooked {
            device,
            queue,
            look_up,
            submit,
            wait_idle,
            present: Some(present),
        });
        // SAFETY: the functions above take anything.
        let find = |name: &CStr| unsafe { device_proc_addr(device, name.as_ptr()) };
        assert!(find(c"vkQueuePresentKHR").is_none(), "the driver has none");
        let theirs = find(c"vkQueueWaitIdle").map(|f| f as usize);
        assert_eq!(
            theirs,
            Some(alone as *const () as usize),
            "not ours to mind"
        );
        let before = submissions();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                // SAFETY: it was found by this name.
                let submit: vk::PFN_vkQueueSubmit =
                    unsafe { transmute(find(c"vkQueueSubmit").expect("there")) };
                for _ in 0..200 {
                    // SAFETY: the function above takes anything.
                    let result = unsafe { submit(queue, 0, std::ptr::null(), vk::Fence::null()) };
                    assert_eq!(result, vk::Result::SUCCESS);
                }
            });
            scope.spawn(|| {
                // SAFETY: it was found by this name.
                let wait_idle: vk::PFN_vkDeviceWaitIdle =
                    unsafe { transmute(find(c"vkDeviceWaitIdle").expect("there")) };
                for _ in 0..200 {
                    // SAFETY: the functions above take anything.
                    unsafe {
                        assert_eq!(wait_idle(device), vk::Result::SUCCESS);
                        let result = queue_present(queue, std::ptr::null());
                        assert_eq!(result, vk::Result::SUCCESS);
                    }
                }
            });
            for _ in 0..200 {
                assert_eq!(exclusively(alone), vk::Result::SUCCESS);
            }
        });
        assert_eq!(submissions() - before, 200);
    }

    /// A second device for something else has the driver's own functions.
    #[test]
    fn devices_that_no_runtime_shares_are_left_alone() {
        unsafe extern "system" fn look_up(
            device: vk::Device,
            _: *const c_char,
        ) -> vk::PFN_vkVoidFunction {
            assert_eq!(device, vk::Device::from_raw(5));
            // SAFETY: never called through this type.
            unsafe { transmute(submit as *const c_void) }
        }
        *OTHERS.write().expect("not poisoned") = Some(look_up);
        let device = vk::Device::from_raw(5);
        // SAFETY: the function above takes anything.
        let found = unsafe { device_proc_addr(device, c"vkQueueSubmit".as_ptr()) };
        let found = found.map(|function| function as usize);
        assert_eq!(found, Some(submit as *const () as usize));
    }

    #[test]
    fn queues_that_nobody_knows_are_lost() {
        let queue = vk::Queue::from_raw(77);
        // SAFETY: nothing is called.
        let result = unsafe { queue_submit(queue, 0, std::ptr::null(), vk::Fence::null()) };
        assert_eq!(result, vk::Result::ERROR_DEVICE_LOST);
    }
}
