#pragma once

#include <cstddef>
#include <span>

namespace nts
{
/// @brief Values at the nodes that a rank owns, and then at ghosts.
template <class T>
struct NodalValues
{
  std::span<T> owned, ghosts;

  /// @brief Address of value i; the B values of node i start at B i.
  T* operator[](std::size_t i) const noexcept
  {
    return i < owned.size() ? owned.data() + i
                            : ghosts.data() + (i - owned.size());
  }
};

using KnownValues = NodalValues<const double>;
using ChangedValues = NodalValues<double>;
} // namespace nts
