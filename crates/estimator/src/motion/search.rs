//! Where an instant lies in a queue that is asked about its end, mostly.

use std::collections::VecDeque;

/// How many elements from the front belong before: `belongs` holds for them and for no later one, as in
/// [`VecDeque::partition_point`], but sought from the back in steps that double: what lies there was touched last and is quick to reach.
pub fn count_before<T>(queue: &VecDeque<T>, belongs: impl Fn(&T) -> bool) -> usize {
    // All from here on do not belong.
    let mut end = queue.len();
    let mut step = 1;
    // All before here belong.
    let mut start = loop {
        let Some(index) = end.checked_sub(step) else {
            break 0;
        };
        if queue.get(index).is_some_and(&belongs) {
            break index + 1;
        }
        end = index;
        step *= 2;
    };
    while start < end {
        let middle = usize::midpoint(start, end);
        if queue.get(middle).is_some_and(&belongs) {
            start = middle + 1;
        } else {
            end = middle;
        }
    }
    start
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_counts_what_halving_counts() {
        for length in 0..40 {
            let mut queue: VecDeque<i32> = (0..length).collect();
            // Wrapped around the end of its storage.
            for next in length..length + 7 {
                queue.pop_front();
                queue.push_back(next);
            }
            for limit in -1..=length + 8 {
                let expected = queue.partition_point(|element| *element < limit);
                assert_eq!(count_before(&queue, |element| *element < limit), expected);
            }
        }
    }
}
