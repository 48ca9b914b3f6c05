#!/bin/sh
# All tests but those of ROS 2 (`make ros2`): tests/all.sh PYTEST FOLDER. In five runs beside each other, since most
# tests wait most of the time: those that need Docker, in two parts with an engine each, of which the first has all that
# need images of ROS 1 or rorg's own; of the others those of hostile input, of properties, of the page and the clients;
# those that start no process, of the repository, its pages and the long tests; and those that start processes. What is
# printed by all but one is in FOLDER, and shown at the end.
# Ends as pytest does; where a run did not come to its end, RORG_TEST_FAILED, which would tell what failed, is taken
# away.
pytest=$1 logs=$2
mkdir -p "$logs"
RORG_TEST_SHARED=$(mktemp -d)  # what one run has made, as a wheel, is there for the others
export RORG_TEST_SHARED
trap 'rm -rf "$RORG_TEST_SHARED"' EXIT
"$pytest" -m "not docker" tests/hostile tests/page tests/clients tests/assurance/proof tests/unit/core/test_properties.py \
  >"$logs/hostile" 2>&1 &
hostile=$!
"$pytest" -m "not docker" tests/unit tests/project tests/docs tests/ros tests/engines tests/assurance \
  --ignore tests/assurance/proof --deselect tests/unit/core/test_properties.py >"$logs/first" 2>&1 &
first=$!
"$pytest" -m "not docker" tests/process tests/docker >"$logs/second" 2>&1 &
second=$!
"$pytest" -m docker --ignore-glob '*_ros2*' tests/docker/test_[a-k]*.py tests/hostile tests/docs tests/ros tests/clients \
  >"$logs/docker" 2>&1 &
docker=$!
trap 'kill -INT $hostile $first $second $docker' INT TERM
"$pytest" -m docker --ignore-glob '*_ros2*' tests/docker/test_[l-z]*.py tests/page tests/engines tests/assurance
codes=$?
for run in $docker $first $second $hostile; do
  wait $run
  codes="$codes $?"
done
cat "$logs/docker" "$logs/first" "$logs/second" "$logs/hostile"
for code in $codes; do
  case $code in
  0) ;;
  1) failed=1 ;;
  *)
    rm -f "$RORG_TEST_FAILED"
    exit "$code"
    ;;
  esac
done
exit "${failed:-0}"
