//! Where an instant lies in a queue that is asked about its end, mostly.

use std::collections::VecDeque;

/// So many elements at the end are looked at one by one before the queue is halved: readings of the last tenths of a second.
const LOOKED_AT: usize = 8;

/// How many elements from the front belong before: `belongs` holds for them and for no later one, as in
/// [`VecDeque::partition_point`], but sought from the back.
#[must_use]
pub fn count_before<T>(queue: &VecDeque<T>, belongs: impl Fn(&T) -> bool) -> usize {
    let mut end = queue.len();
    for element in queue.iter().rev().take(LOOKED_AT) {
        if belongs(element) {
            return end;
        }
        end -= 1;
    }
    if end == 0 {
        return 0;
    }
    queue.partition_point(belongs)
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
