//! Parallel tasks whose results are consumed in order, with a bounded number of pending results and
//! a memory budget.
//!
//! Tasks run on rayon's current pool. The calling thread consumes the results in the order of the
//! tasks, so that the outcome does not depend on the number of threads.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

/// Maximum number of running tasks and pending results per thread: enough that no thread idles
/// behind a slow task.
const WINDOW_PER_THREAD: usize = 3;
/// Sleep of an idle thread of the pool between polls.
const IDLE_SLEEP: Duration = Duration::from_micros(200);

/// Calls `work` for every task in parallel and `take` for every result in order.
///
/// # Errors
///
/// The first error of `take`, which ends the loop.
pub fn for_each_in_order<T: Sync, R: Send, E>(
    tasks: &[T],
    work: impl Fn(&T) -> R + Sync,
    take: impl FnMut(&T, R) -> Result<(), E>,
) -> Result<(), E> {
    for_each_within_budget(u64::MAX, |_| 0, tasks, work, take)
}

/// [`for_each_in_order`] with a memory budget: a task waits until its `bytes` and those of all
/// running tasks are within `budget`, or until no other task runs. The results do not depend on the
/// budget.
///
/// # Errors
///
/// The first error of `take`, which ends the loop.
pub fn for_each_within_budget<T: Sync, R: Send, E>(
    budget: u64,
    bytes: impl Fn(&T) -> u64,
    tasks: &[T],
    work: impl Fn(&T) -> R + Sync,
    mut take: impl FnMut(&T, R) -> Result<(), E>,
) -> Result<(), E> {
    let window = WINDOW_PER_THREAD * rayon::current_num_threads();
    let (sender, receiver) = mpsc::channel();
    rayon::in_place_scope(|scope| {
        let work = &work;
        let (mut started, mut in_use) = (0, 0u64);
        // Only the calling thread waits for memory. A waiting thread of the pool could deadlock: it
        // may run a stolen task inside another one that holds memory.
        let mut start = |taken: usize, done: Option<usize>| {
            in_use -= done.map_or(0, |done| bytes(&tasks[done]));
            while let Some(task) = tasks[..tasks.len().min(taken + window)].get(started)
                && (in_use == 0 || in_use.saturating_add(bytes(task)) <= budget)
            {
                let (sender, index) = (sender.clone(), started);
                scope.spawn(move |_| {
                    let result = catch_unwind(AssertUnwindSafe(|| work(task)));
                    // The receiver is gone after an error.
                    let _ = sender.send((index, result));
                });
                in_use += bytes(task);
                started += 1;
            }
        };
        let mut waiting = BTreeMap::new();
        for (index, task) in tasks.iter().enumerate() {
            start(index, None);
            let result = loop {
                if let Some(result) = waiting.remove(&index) {
                    break result;
                }
                let (done, result) = receive(&receiver);
                waiting.insert(done, result);
                start(index, Some(done));
            };
            take(task, result.unwrap_or_else(|panic| resume_unwind(panic)))?;
        }
        Ok(())
    })
}

/// Waits for a message. A thread of the pool runs other tasks meanwhile, because the sender may
/// have no other thread to run on.
fn receive<T>(receiver: &Receiver<T>) -> T {
    loop {
        if let Ok(message) = receiver.try_recv() {
            return message;
        }
        match rayon::yield_now() {
            Some(rayon::Yield::Executed) => {}
            Some(rayon::Yield::Idle) => thread::sleep(IDLE_SLEEP),
            None => return receiver.recv().expect("the caller holds a sender"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn squares(tasks: &[u64]) -> Vec<u64> {
        let mut taken = Vec::new();
        let square = |task: &u64| {
            // Earlier tasks are slower.
            thread::sleep(Duration::from_micros(500 / (task + 1)));
            task * task
        };
        for_each_in_order(tasks, square, |_, result| {
            taken.push(result);
            Ok::<(), ()>(())
        })
        .unwrap();
        taken
    }

    #[test]
    fn results_are_ordered_inside_and_outside_a_pool() {
        let tasks: Vec<u64> = (0..100).collect();
        let expected: Vec<u64> = tasks.iter().map(|task| task * task).collect();
        assert_eq!(squares(&tasks), expected);
        for threads in 1..=3 {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| squares(&tasks)), expected);
        }
        assert!(squares(&[]).is_empty());
    }

    #[test]
    fn after_an_error_at_most_the_window_was_computed() {
        let computed = std::sync::atomic::AtomicUsize::new(0);
        let tasks = [(); 1000];
        let count = |_: &()| computed.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        assert_eq!(for_each_in_order(&tasks, count, |_, _| Err("stop")), Err("stop"));
        assert!(computed.into_inner() <= WINDOW_PER_THREAD * rayon::current_num_threads());
    }

    #[test]
    fn budget_bounds_memory_and_does_not_change_results() {
        use std::sync::atomic::{AtomicU64, Ordering};
        let tasks: Vec<u64> = (0..60).map(|k| 1 + k % 7).collect();
        let expected: Vec<u64> = tasks.iter().map(|task| task * task).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
        // The last budget is below every task: one at a time.
        for budget in [u64::MAX, 10, 7, 0] {
            let (in_use, most) = (AtomicU64::new(0), AtomicU64::new(0));
            let work = |task: &u64| {
                most.fetch_max(in_use.fetch_add(*task, Ordering::SeqCst) + task, Ordering::SeqCst);
                thread::sleep(Duration::from_micros(200));
                in_use.fetch_sub(*task, Ordering::SeqCst);
                task * task
            };
            let mut taken = Vec::new();
            let take = |_: &u64, result| {
                taken.push(result);
                Ok::<(), ()>(())
            };
            pool.install(|| for_each_within_budget(budget, |task| *task, &tasks, work, take))
                .unwrap();
            assert_eq!(taken, expected);
            assert!(most.into_inner() <= budget.max(7), "budget {budget}");
        }
    }

    #[test]
    #[should_panic(expected = "task 7")]
    fn panic_of_a_task_propagates() {
        let tasks: Vec<u32> = (0..20).collect();
        let work = |task: &u32| assert!(*task != 7, "task {task}");
        let _ = for_each_in_order(&tasks, work, |_, ()| Ok::<(), ()>(()));
    }
}
