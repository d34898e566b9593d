"""Shards on Ray: an executor for ``ob.uncertainty(executor=…)`` in ten lines, and a run on two workers.

    python examples/ray_executor.py          (pip install ray; half a minute)

Ray starts a shard again if its worker dies.
"""

import ray

import octobayes as ob


class RayExecutor:
    """Submits calls to Ray. Options are those of ``ray.remote``: num_cpus, memory, max_retries, …"""

    def __init__(self, **options):
        self.call = ray.remote(**options)(lambda function, *arguments: function(*arguments))
        self.sent, self.reference = None, None

    def submit(self, function, *arguments):
        # All shards share a function, and with it the model: it goes into Ray's store once.
        if function is not self.sent:
            self.sent, self.reference = function, ray.put(function)
        return self.call.remote(self.reference, *arguments).future()


if __name__ == "__main__":
    ray.init(num_cpus=2, include_dashboard=False)
    scene = ob.open_model("scene:courtyard")
    u = ob.uncertainty(scene, level=7, rays=400_000, executor=RayExecutor(num_cpus=1), shards=8)
    u.save("field.oct")
