//! Parallel loop over tasks.

use rayon::prelude::*;

use super::task::Task;

/// Runs `work` on every task and its item, in parallel if there are several.
pub(crate) fn for_each_task<T: Send>(
    tasks: &[Task],
    items: &mut [T],
    work: impl Fn(&Task, &mut T) + Sync,
) {
    if tasks.len() > 1 {
        tasks.par_iter().zip(items).with_max_len(1).for_each(|(task, item)| work(task, item));
    } else {
        tasks.iter().zip(items).for_each(|(task, item)| work(task, item));
    }
}
