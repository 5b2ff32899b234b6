// Threads that wait for a batch of tasks, so that a batch of microseconds is worth sharing out.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

namespace fl::twin {

// A batch has tasks 0 to count - 1. Every thread has a share of them, the same in every batch of that size,
// so that what a task needs stays in the cache of its core; it helps with other shares when its own is done.
// A helper that sleeps through a batch delays none: the others take its tasks.
class Workers {
  public:
    // threads: in all, the calling one included.
    Workers(int threads, std::function<void(size_t)> task)
        : task_(std::move(task)), share_count_(static_cast<size_t>(threads)),
          shares_(std::make_unique<Share[]>(share_count_)) {
        for (size_t i = 1; i < share_count_; ++i) helpers_.emplace_back([this, i] { help(i); });
    }
    ~Workers() {
        closing_ = true;
        call();
        for (std::thread &t : helpers_) t.join();
    }
    Workers(const Workers &) = delete;
    Workers &operator=(const Workers &) = delete;

    // Does every one of `count` tasks once, in any order, and returns when all are done.
    // @pre count < 2^32
    void run(size_t count) {
        if (helpers_.empty() || count < 2) {
            for (size_t i = 0; i < count; ++i) task_(i);
            return;
        }
        more_ = true;
        left_ = count; // before any of them may be taken
        for (size_t i = 0; i < share_count_; ++i)
            shares_[i].tickets =
                Tickets{first_of(i + 1, share_count_, count)} << 32 | first_of(i, share_count_, count);
        call();
        take_tasks(0);
        for (size_t left = await(left_, 0); left != 0; left = left_) left_.wait(left);
    }

    size_t thread_count() const { return share_count_; }
    // The first of `count` tasks that thread `thread` of `threads` has a share of.
    static constexpr size_t first_of(size_t thread, size_t threads, size_t count) {
        return thread * count / threads;
    }

    // No batch follows soon: helpers need not look out for one.
    void rest() { more_ = false; }

  private:
    // The end of a share above, the next of its tasks below: one that is late sees that its batch is over.
    using Tickets = uint64_t;
    struct alignas(64) Share {
        std::atomic<Tickets> tickets{0};
    };
    // Some ten microseconds: slices follow each other sooner, and waking a thread takes longer. Then some
    // tens more, in which any other may have the core: the last task of a slice takes up to 50 us, and a
    // thread that slept through it would miss the beginning of the next one.
    static constexpr int spins = 1000, yields = 150;

    static void pause() {
#if defined(__x86_64__) || defined(__i386__)
        __builtin_ia32_pause();
#endif
    }
    // Looks for a while whether a number becomes `wanted`; returns it as last seen.
    size_t await(const std::atomic<size_t> &number, size_t wanted) const {
        size_t seen = number;
        for (int i = 0; i < spins && seen != wanted && more_; ++i, seen = number) pause();
        for (int i = 0; i < yields && seen != wanted && more_; ++i, seen = number) std::this_thread::yield();
        return seen;
    }

    void call() {
        batch_.fetch_add(1);
        batch_.notify_all();
    }
    void take_tasks(size_t first) {
        for (size_t i = 0; i < share_count_; ++i) take_share(shares_[(first + i) % share_count_].tickets);
    }
    void take_share(std::atomic<Tickets> &tickets) {
        for (Tickets t = tickets.fetch_add(1); static_cast<uint32_t>(t) < t >> 32; t = tickets.fetch_add(1)) {
            task_(static_cast<uint32_t>(t));
            if (left_.fetch_sub(1) == 1) left_.notify_all();
        }
    }
    void help(size_t share) {
        for (size_t seen = 0; !closing_; seen = batch_) {
            take_tasks(share);
            if (await(batch_, seen + 1) == seen) batch_.wait(seen);
        }
    }

    const std::function<void(size_t)> task_;
    const size_t share_count_;
    const std::unique_ptr<Share[]> shares_;
    std::vector<std::thread> helpers_;
    // apart: one is looked at by those that wait for the next batch while the other counts
    alignas(64) std::atomic<size_t> left_{0};  // tasks of this batch that are not done
    alignas(64) std::atomic<size_t> batch_{0}; // number of it
    std::atomic<bool> more_{false};            // batches follow each other
    std::atomic<bool> closing_{false};
};

} // namespace fl::twin
